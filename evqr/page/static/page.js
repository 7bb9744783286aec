"use strict";

// The page asks for the whole state once a second and draws it. Texts of codes are shown as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";
const at = (id) => document.getElementById(id);

function say(id, text) {
  at(id).textContent = text;
}

function svg(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function shortNumber(value) {
  if (value >= 1e6) return (value / 1e6).toFixed(1) + " M";
  if (value >= 1e3) return (value / 1e3).toFixed(value >= 1e4 ? 0 : 1) + " k";
  return String(Math.round(value));
}

function span(seconds) {
  if (seconds < 90) return Math.round(seconds) + " s";
  if (seconds < 5400) return Math.round(seconds / 60) + " min";
  if (seconds < 172800) return Math.round(seconds / 3600) + " h";
  return Math.round(seconds / 86400) + " d";
}

// ---- charts

function drawHistory(history) {
  const width = at("history").clientWidth || 960, height = 150, foot = 18, slots = 60;
  const counts = new Map(history.slots.map((slot) => [slot[0], slot]));
  const most = Math.max(1, ...history.slots.map((slot) => slot[1] + slot[2]));
  const chart = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": `parts a minute over the last ${slots} minutes, at most ${most}` });
  const step = width / slots, room = height - foot - 12;
  chart.append(svg("line", { x1: 0, x2: width, y1: height - foot, y2: height - foot }));
  for (let k = 0; k < slots; k++) {
    const slot = counts.get(history.now - slots + 1 + k);
    if (!slot) continue;
    const good = (room * slot[1]) / most, bad = (room * slot[2]) / most;
    const x = k * step + 1, floor = height - foot;
    chart.append(svg("rect", { class: "good", x, y: floor - good, width: step - 2, height: good }));
    chart.append(svg("rect", { class: "bad", x, y: floor - good - bad, width: step - 2, height: bad }));
  }
  chart.append(svg("text", { x: 2, y: 10 }, String(most)));
  chart.append(svg("text", { x: 2, y: height - 4 }, "an hour ago"));
  chart.append(svg("text", { x: width - 2, y: height - 4, "text-anchor": "end" }, "now"));
  at("history").replaceChildren(chart);
}

function drawHistogram(id, counts, edges) {
  const width = at(id).clientWidth || 480, height = 90, foot = 16, step = width / counts.length;
  const most = Math.max(1, ...counts);
  const chart = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": counts.map((count, k) => `${k < edges.length ? "up to " + edges[k] : "more"}: ${count}`).join(", ") });
  chart.append(svg("line", { x1: 0, x2: width, y1: height - foot, y2: height - foot }));
  counts.forEach((count, k) => {
    const tall = ((height - foot - 4) * count) / most;
    chart.append(svg("rect", { class: "bar", x: k * step + 2, y: height - foot - tall, width: step - 4, height: tall }));
    const label = k < edges.length ? (edges[k] >= 1000 ? edges[k] / 1000 + "k" : edges[k]) : "more";
    chart.append(svg("text", { x: (k + 0.5) * step, y: height - 3, "text-anchor": "middle" }, String(label)));
  });
  at(id).replaceChildren(chart);
}

// ---- the last code

function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function drawView(view, last) {
  const canvas = at("view");
  if (!view) return;
  canvas.width = view.columns;
  canvas.height = view.rows;
  const context = canvas.getContext("2d");
  const cells = Uint8Array.from(atob(view.cells), (c) => c.charCodeAt(0));
  context.clearRect(0, 0, canvas.width, canvas.height);
  for (const [wanted, name] of [[true, "--brighter"], [false, "--darker"]]) {
    context.fillStyle = color(name);
    for (let k = 0; k < cells.length; k++) {
      const value = (cells[k] << 24) >> 24;
      if (value === 0 || value > 0 !== wanted) continue;
      context.globalAlpha = Math.min(1, 0.35 + Math.abs(value) / 4);
      context.fillRect(k % view.columns, Math.floor(k / view.columns), 1, 1);
    }
  }
  context.globalAlpha = 1;
  say("view-of", view.of_code ? "its events, and its outline" : "newest events");
  if (!last || !last.corners_px) return;
  const scale = view.columns / view.width;
  context.strokeStyle = color("--good");
  context.lineWidth = 1.5;
  context.beginPath();
  last.corners_px.forEach(([x, y], k) => context[k ? "lineTo" : "moveTo"](x * scale, y * scale));
  context.closePath();
  context.stroke();
}

function drawModules(rows) {
  const canvas = at("modules");
  at("of-modules").hidden = rows.length === 0;
  if (!rows.length) return;
  const quiet = 2;
  canvas.width = rows[0].length + 2 * quiet;
  canvas.height = rows.length + 2 * quiet;
  const context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = "#000";
  rows.forEach((row, v) => [...row].forEach((dark, u) => {
    if (dark === "1") context.fillRect(u + quiet, v + quiet, 1, 1);
  }));
}

// ---- tables

function row(cells) {
  const made = document.createElement("tr");
  for (const cell of cells) {
    const place = document.createElement("td");
    if (cell instanceof Node) place.append(cell);
    else place.textContent = cell === null || cell === undefined ? "" : String(cell);
    made.append(place);
  }
  return made;
}

function marked(text, name) {
  const made = document.createElement("span");
  made.className = name;
  made.textContent = text;
  return made;
}

function link(where, text) {
  const made = document.createElement("a");
  made.href = where;
  made.textContent = text;
  return made;
}

function clock(utc) {
  return utc ? utc.slice(11, 19) : "";
}

function said(part) {
  if (part.read) return part.texts.join(" | ");
  if (part.texts && part.texts.length) return marked("no match: " + part.texts.join(" | "), "bad-text");
  return marked("NO READ", "bad-text");
}

function fill(id, rows, columns, without) {
  if (!rows.length) {
    const made = row([marked(without, "none")]);
    made.firstChild.colSpan = columns;
    rows = [made];
  }
  at(id).replaceChildren(...rows);
}

function drawTables(state) {
  fill("parts", state.parts.map((part) =>
    row([part.part, part.trigger, said(part), part.latency_ms === null ? "" : part.latency_ms.toFixed(1), clock(part.t_utc)])),
    5, "no part has passed yet");
  fill("no-reads", state.no_reads.map((part) => {
    const links = document.createElement("span");
    if (part.file) {
      const name = "no-reads/" + encodeURIComponent(part.file);
      links.append(link(name + "/picture", "picture"), " ", link(name + "/events", "events"));
    }
    return row([part.part, part.trigger, part.reason, links]);
  }), 4, "all parts were read");
  say("reasons", Object.entries(state.reasons).map(([code, count]) => `${code.replaceAll("_", " ")}: ${count}`).join(", "));
  fill("sinks", state.sinks.map((sink) =>
    row([sink.name, sink.up ? marked("up", "good-text") : marked(sink.error, "bad-text"), sink.delivered, sink.waiting, sink.lost])),
    5, "standard output alone");
}

// ---- all of it

function draw(state) {
  const counts = state.counts, good = state.problems.length === 0;
  document.title = (state.line || "evqr") + (good ? "" : " (problem)");
  say("line", state.line || "evqr");
  say("status", good ? "ready" : "not ready");
  at("status").className = good ? "good" : "bad";
  say("source", [state.source && "reads " + state.source, state.job && "job " + state.job].filter(Boolean).join(", "));
  at("problems").hidden = good;
  at("problems").replaceChildren(...state.problems.map((text) => {
    const made = document.createElement("li");
    made.textContent = text;
    return made;
  }));
  say("rate", state.read_rate === null ? "-" : (100 * state.read_rate).toFixed(1) + " %");
  say("rate-of", state.read_rate_of ? `read rate of the last ${state.read_rate_of}` : "read rate");
  const newest = state.history.slots.filter((slot) => slot[0] >= state.history.now - 1);
  say("minute", newest.length ? Math.max(...newest.map((slot) => slot[1] + slot[2])) : 0);
  say("read", counts.parts_read || 0);
  say("unread", counts.parts_not_read || 0);
  say("events", shortNumber(state.events_per_s));
  say("behind", state.behind_ms < 1000 ? Math.round(state.behind_ms) + " ms" : span(state.behind_ms / 1000));
  say("uptime", span(state.uptime_s));
  say("last-text", state.last ? state.last.text : "none yet");
  say("counts", `gaps ${counts.gap || 0}, clock resets ${counts.clock || 0}, overloads ${counts.overload || 0},`
    + ` source lost ${counts.interruptions || 0} times`);
  drawHistory(state.history);
  drawHistogram("latency", state.latency_ms, state.edges_ms);
  drawHistogram("compute", state.compute_ms, state.edges_ms);
  drawView(state.view, state.last);
  drawModules(state.last ? state.last.modules : []);
  drawTables(state);
}

async function refresh() {
  try {
    const answer = await fetch("api/state", { signal: AbortSignal.timeout(5000) });
    if (!answer.ok) throw new Error(await answer.text());
    draw(await answer.json());
  } catch (error) {
    say("status", "evqr does not answer: " + error.message);
    at("status").className = "bad";
  }
  setTimeout(refresh, 1000);
}

refresh();
