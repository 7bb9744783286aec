"""Table, figures, report and command line, of cells that are made up."""

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from evqr import main as cli
from evqr.output.drawing import FALSE_DARK, FALSE_LIGHT
from evqr.paper.dataset.manifest import load_manifest, save_manifest
from evqr.paper.evaluate.cell import Cell, CellResult
from evqr.paper.evaluate.details import details_of
from evqr.paper.evaluate.figures import figures_of
from evqr.paper.evaluate.metrics import Trial
from evqr.paper.evaluate.paper import printed
from evqr.paper.evaluate.report import About, write_report
from evqr.paper.evaluate.table import csv_of, markdown_of, rows_of, table_of


def made_up(tiny, method, *, wrong=0, **changes):
    entry = load_manifest(tiny)[1]
    truth = entry.truth()
    modules = truth.modules.copy()
    modules[tuple(np.argwhere(~truth.known)[:wrong].T)] *= -1
    read = {} if wrong else {"text": "TINY", "seconds_to_read": 0.25, "iterations_to_read": 3}
    trial = Trial(
        modules=modules, converged=True, best_accuracy=0.75, confidence=0.9999, events_per_edge=5.0,
        seconds=0.5, **read,
    )  # fmt: skip
    entry = replace(entry, **changes)
    return CellResult(
        cell=Cell(recording=entry.name, method=method),
        entry=entry,
        trials=(trial, trial),
        picture=np.zeros((160, 160), np.uint8),
        speed_px_ms=5.0,
        machine="an abacus",
        source="a monk",
    )


@pytest.fixture
def results(tiny):
    return [
        made_up(tiny, "evqr", scene="faster"),
        made_up(tiny, "descent", scene="faster", wrong=30),
        made_up(tiny, "descent", scene="faster", angle=0.0),
    ]


def test_the_paper_s_numbers():
    line = printed("slower", "bardow", 45)
    assert (line.trials, line.mode_accuracy, line.seconds_to_read) == (172, 99.0, 21.1)
    assert (line.iterations_to_read, line.max_accuracy, line.read_rate, line.image_read_rate) == (
        33.5,
        100,
        100,
        1.16,
    )
    assert printed("faster", "image", 0).mode_accuracy is None
    assert printed("faster", "evqr", 0) is None and printed("faster", "descent", 20) is None
    kinds = [("faster", "slower", "simulator"), ("image", "bardow", "without_qr", "descent"), (0, 30, 45)]
    assert all(printed(s, m, a) for s in kinds[0] for m in kinds[1] for a in kinds[2])


def test_the_table_is_in_the_paper_s_order_with_its_numbers_beside(results):
    lines = table_of(results)
    assert [(line.method, line.angle) for line in lines] == [("descent", 0), ("descent", 30), ("evqr", 30)]
    rows = rows_of(lines)
    assert rows[1][3:6] == ["2 (150)", "100.0 (99.2)", "0.25 (0.75)"]
    assert rows[2][10] == "0.0 (96.7)" and rows[3][10] == "100.0" and rows[2][5] == "- (0.34)"
    assert rows[0][6] == "median time [s]" and rows[1][6] == "0.25" and rows[2][6] == "-"
    markdown = markdown_of(lines).splitlines()
    assert markdown[2].startswith("| faster | Ours (the paper's) | 0 |") and markdown[3].startswith(
        "|  |  | 30 |"
    )


def test_the_paper_s_method_in_detail(tiny, results):
    assert [part.rows[0][0] for part in details_of(results, [])] == ["events per edge"]
    descent = made_up(tiny, "descent", scene="faster")
    first, second = descent.trials
    descent = replace(
        descent,
        trials=(
            replace(first, start="paper", pose_iterations=10, iterations_to_few=4),
            replace(second, start="solver", pose_iterations=20),
            replace(second, modules=None, start=None),
        ),
    )
    table, _ = details_of([descent, results[0]], [])
    assert table.rows[1:] == [["faster", "30", "3", "1", "1", "1", "15", "3", "6.04", "4", "1"]]
    assert table.markdown.splitlines()[-1] == "| faster | 30 | 3 | 1 | 1 | 1 | 15 | 3 | 6.04 | 4 | 1 |"


def test_scenes_made_harder(tiny):
    def few(result, keep, *counts):
        trials = tuple(replace(result.trials[0], iterations_to_few=count) for count in counts)
        return replace(result, cell=replace(result.cell, keep=keep), trials=trials)

    descent, rated = (made_up(tiny, method, scene="faster") for method in ("descent", "without_qr"))
    missed = made_up(tiny, "without_qr", scene="faster", wrong=30)
    stretched = replace(missed, cell=replace(missed.cell, stretch=2.0))
    table, sweep = [few(descent, 1.0, 4, 6), rated], [few(descent, 0.5, None, 9, 12), missed, stretched]
    sweep[1] = few(missed, 0.5, None)
    assert details_of(table, [stretched])[-1].rows[0][0] == "events per edge"
    harder = details_of(table, [*sweep, few(descent, 0.25, None)])[0]
    assert harder.rows == [
        ["scene", "deg.", "the paper's", "100 % of the events", "50 % of the events", "25 % of the events"],
        ["faster", "30", "4 %; 6.04", "100 %; 3 (2); 5 (2)", "0 %; 3 (3); 10.5 (2)", "-"],
    ]
    assert "w/o QR" in harder.caption and "Ours (the paper's)" in harder.caption


def test_csv_has_a_column_a_number(results):
    rows = list(csv.DictReader(io.StringIO(csv_of(table_of(results)))))
    assert rows[0]["paper_read_rate"] == "92.7" and rows[0]["read_rate"] == "1.0"
    assert rows[2]["paper_read_rate"] == "" and rows[2]["method"] == "evqr"


def test_all_figures_are_drawn(results):
    names = set(figures_of(results, []))
    assert names == {
        "figure7", "figure8", "read-rate-against-angle", "read-rate-against-motion",
        "bits-against-events", "reads-against-events", "time-against-events", "confidence",
    }  # fmt: skip
    assert not figures_of([], [])


def test_lines_against_events_are_of_one_angle_each(tiny):
    def cell(angle, events, wrong=0):
        result = made_up(tiny, "evqr", scene="faster", angle=angle, wrong=wrong)
        trial = replace(result.trials[0], events_per_edge=events, best_accuracy=0.5 if wrong else 1.0)
        return replace(result, trials=(trial,))

    # at 0 degrees nothing is read, at 30 all: mixed, a line over 5, 7, 9 and 13 events would zigzag
    cells = [cell(0.0, 5.0, 30), cell(30.0, 7.0), cell(0.0, 9.0, 30), cell(30.0, 13.0)]
    figures = figures_of(cells, [])
    for name, levels in (("reads-against-events", (0, 100)), ("bits-against-events", (50, 100))):
        lines = {axes.get_ylabel(): axes.lines for axes in figures[name].axes}
        assert list(lines) == ["0°", "30°"]
        drawn = {
            angle: [line.get_xydata().tolist() for line in of_angle] for angle, of_angle in lines.items()
        }
        low, high = levels
        assert drawn == {"0°": [[[5, low], [9, low]]], "30°": [[[7, high], [13, high]]]}


def test_wrong_modules_are_magenta_and_green(results):
    from matplotlib.colors import to_hex

    figure = figures_of(results, [])["figure8"]
    images = [axes.images[0] for axes in figure.axes if axes.images]
    shown = [
        [to_hex(colour) for colour in image.to_rgba(image.get_array()).reshape(-1, 4)] for image in images
    ]
    wrong = results[1].trials[0].modules[wrong_modules(results[1])]
    dark, light = int((wrong < 0).sum()), int((wrong > 0).sum())
    assert dark and light and dark + light == 30
    # magenta: estimated dark; green: estimated light
    assert sorted((colours.count(FALSE_DARK), colours.count(FALSE_LIGHT)) for colours in shown) == [
        (0, 0), (0, 0), (dark, light),
    ]  # fmt: skip


def wrong_modules(result):
    return result.trials[0].modules != result.truth.modules


def test_a_cell_where_nothing_was_found_says_so(tiny, results):
    nothing = made_up(tiny, "descent", scene="slower")
    nothing = replace(nothing, trials=(Trial(),))
    figure = figures_of([*results, nothing], [])["figure8"]
    assert [text.get_text() for axes in figure.axes for text in axes.texts].count("none converged") == 1


def test_the_report_holds_its_pictures(results, tmp_path):
    written = write_report(tmp_path, results, [], About(command="evqr table1", dataset="made up <here>"))
    assert all(path.stat().st_size for path in written)
    page = (tmp_path / "report.html").read_text()
    assert len(re.findall(r'src="data:image/png;base64,', page)) == 8 and "http" not in page
    assert (
        "made up &lt;here&gt;" in page
        and "an abacus" in page
        and "a monk" in page
        and '<span class="paper">(92.7)' in page
    )
    told = json.loads((tmp_path / "table1.json").read_text())
    assert told["about"]["command"] == "evqr table1" and len(told["lines"]) == 3
    assert told["details"][0]["rows"][0][0] == "events per edge" and told["sweep"] == []
    markdown = (tmp_path / "table1.md").read_text()
    assert "| faster |" in markdown
    assert page.count("<table>") == 2 and "<th>events per edge</th>" in page and "<td>50 % of 4</td>" in page
    # two windows each, with 5 events an edge
    assert re.search(r"evqr, each window alone \| - \| - \| - \| - \| 100 % of 2 \|", markdown)
    assert re.search(r"Ours \(the paper's\) \| - \| - \| - \| - \| 50 % of 4 \|", markdown)


def run(*arguments):
    return CliRunner().invoke(cli.evqr, [str(a) for a in arguments], standalone_mode=False)


def test_table1_from_the_command_line(tiny, tmp_path):
    options = ["--methods", "evqr,integrate", "--trials", "integrate=1", "--quick"]
    done = run("table1", "--dataset", tiny, "--out", tmp_path, *options)
    assert done.exception is None, done.exception
    lines = json.loads((tmp_path / "table1.json").read_text())["lines"]
    assert [(line["method"], line["trials"]) for line in lines] == [
        ("evqr", 2), ("evqr", 2), ("integrate", 1), ("integrate", 1),
    ]  # fmt: skip


def test_a_method_that_takes_long_is_run_only_by_its_name(tiny, tmp_path, monkeypatch):
    from evqr.paper import cli as commands

    few = {name: commands.METHODS[name] for name in ("image", "bardow_full")}
    monkeypatch.setattr(commands, "METHODS", few)
    for options, methods in ([], {"image"}), (["--methods", "bardow_full"], {"bardow_full"}):
        done = run("table1", "--dataset", tiny, "--out", tmp_path, "--no-sweep", *options)
        assert done.exception is None, done.exception
        lines = json.loads((tmp_path / "table1.json").read_text())["lines"]
        assert {line["method"] for line in lines} == methods


def test_the_sweep_from_the_command_line(tiny, tmp_path):
    options = ["--methods", "integrate", "--trials", "1", "--sweep"]
    done = run("table1", "--dataset", tiny, "--out", tmp_path, *options)
    assert done.exception is None, done.exception
    told = json.loads((tmp_path / "table1.json").read_text())
    assert {(cell["stretch"], cell["keep"]) for cell in told["sweep"]} == {
        (0.5, 1.0), (2.0, 1.0), (1.0, 0.5), (1.0, 0.35), (1.0, 0.25), (1.0, 0.18), (1.0, 0.12),
    }  # fmt: skip
    assert len(told["sweep"]) == 14 and len(told["lines"]) == 2


def test_two_recordings_of_one_cell_are_refused(tiny, tmp_path):
    entries = load_manifest(tiny)
    again = [replace(entries[0], name="belt again", recording=str(tiny / entries[0].recording))]
    kept = [replace(entry, recording=str(tiny / entry.recording)) for entry in entries]
    save_manifest(tmp_path, kept + again)
    done = run("table1", "--dataset", tmp_path, "--out", tmp_path / "out")
    assert "'belt-00' and 'belt again' both show 'TINY' at 0 deg" in str(done.exception)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--methods", "magic"], "no method 'magic'"),
        (["--scenes", "moon"], "no scene 'moon'"),
        (["--trials", "magic=3"], "write N or METHOD=N"),
        (["--trials", "0"], "write N or METHOD=N"),
        (["--dask", "nowhere"], "no scheduler answers"),
    ],
    ids=["method", "scene", "trials of no method", "no trials", "dask"],
)
def test_table1_refuses(tiny, tmp_path, options, message):
    done = run("table1", "--dataset", tiny, "--out", tmp_path, *options)
    assert message in str(done.exception)


def test_dataset_make_from_the_command_line(tmp_path, monkeypatch):
    from evqr.paper.dataset import scenes

    real = scenes.scenes
    monkeypatch.setattr(scenes, "scenes", lambda **options: list(real(**options))[:1])
    done = run(
        "dataset", "make", tmp_path / "qrecd", "--windows", 13, "--text", "ELSE", "--text", "B", "--seed", 9
    )
    assert done.exception is None and "1 scenes" in done.output
    assert load_manifest(tmp_path / "qrecd")[0].text == "ELSE"
    assert "| `ELSE` | 13 | 9 |" in (tmp_path / "qrecd" / "README.md").read_text()


def test_help_names_the_commands():
    assert {"dataset", "table1", "read"} <= set(cli.evqr.list_commands(None))
    assert "Bardow" not in run("--help").output
