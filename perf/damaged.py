#!/usr/bin/env python3
"""Decode damaged grids of every symbology, count wrong texts, and compare the bound on chance with counts.

usage: damaged.py [--grids 1000000] [--symbols 5000] [--coins 20000] [--log FILE] [--symbologies qr,...]

Grids alone: so many decodes, shared out evenly over the symbologies and over distinct symbols of each, of any
size up to 45 modules.  Modules are wrong as often as they are measured to be (`evqr.fit.certainty`) in a
window of some information, drawn anew for each grid from next to nothing to plenty; in every other grid a
blot of coins covers up to a third.  Then coins alone, judged by a bound of one reading in thirty grids
instead of one in a thousand million: so many that counts can be compared with what the bound allows, which
must not be less.  With --log counts are lines of JSON, and a run goes on from where the last one ended.
Exit 1 for a wrong text.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is imported

import argparse
import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from evqr.config import DecodeConfig
from evqr.fit.certainty import log_odds
from evqr.simulate.config import CodePlacement
from evqr.simulate.printed import PrintedSymbol, make_symbol
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.space import CodeSpace
from evqr.symbol.symbols import SYMBOLS, space_of
from evqr.symbology import Symbology

A_ROUND = 100
"""Symbols of a symbology that a line of the log is of."""

INFORMATION = (1.0, 60.0)
ODDS = 30.0


def symbols(symbology: Symbology, seed: int, number: int) -> list[PrintedSymbol]:
    """Make distinct symbols: their texts begin with their numbers."""
    rng = np.random.default_rng([seed, list(SYMBOLS).index(symbology), number])
    sizes = [version for version, shape in SYMBOLS[symbology].sizes.items() if max(shape) <= 45]
    made = []
    for k in range(A_ROUND):
        version = sizes[rng.integers(len(sizes))]
        levels = ("L",) if symbology is Symbology.MICRO_QR_CODE else ("M", "H")
        placement = CodePlacement(
            text=f"{A_ROUND * number + k:05d}"[: 5 if version != "10x10" else 6],
            symbology=symbology,
            version=version,
            ec=levels[rng.integers(len(levels))],
        )
        made.append(make_symbol(placement))
    return made


def damaged(symbol: PrintedSymbol, rng: np.random.Generator, blot: bool) -> NDArray[np.float32]:
    """Draw estimates of a symbol's modules, each wrong as likely as measured."""
    exact, space = np.where(symbol.modules > 0, -1.0, 1.0), symbol.space
    information = float(np.exp(rng.uniform(*np.log(INFORMATION))))
    strength = np.abs(rng.normal(1.0, 0.6 / information**0.25, exact.shape)).astype(np.float32)
    wrong = rng.random(exact.shape) < 1.0 / (1.0 + np.exp(np.abs(log_odds(strength, space, information))))
    if blot:
        rows, columns = exact.shape
        v, u = np.indices(exact.shape)
        radius = rng.uniform(0.0, 0.33) * min(rows, columns)
        inside = (v - rng.uniform(0, rows)) ** 2 + (u - rng.uniform(0, columns)) ** 2 < radius**2
        wrong |= inside & (rng.random(exact.shape) < 0.5)
    return np.where(wrong, -exact, exact).astype(np.float32) * strength


def round_of(symbology: Symbology, number: int, seed: int, each: int) -> dict:
    """Decode some damaged grids of each of some symbols."""
    rng = np.random.default_rng([seed, list(SYMBOLS).index(symbology), number, 1])
    counts, wrong = Counter(), []
    for symbol in symbols(symbology, seed, number):
        for k in range(each):
            q = damaged(symbol, rng, bool(k % 2))
            outcome = decode_grid(q, symbol.space, effort="full" if k % 4 < 2 else "quick")
            if not isinstance(outcome, Decoded):
                counts["refused"] += 1
            elif outcome.text == symbol.placement.text:
                counts["right"] += 1
            else:
                wrong.append([symbol.placement.text, outcome.text, str(symbol.space), outcome.log10_chance])
    return {"symbology": symbology.value, "number": number, "seed": seed, **counts, "wrong": wrong}


def coins(symbology: Symbology, count: int, seed: int) -> tuple[int, CodeSpace]:
    """Count readings of coins, of the smallest size, that a bound of one in `ODDS` grids lets pass."""
    rng = np.random.default_rng([seed, list(SYMBOLS).index(symbology), 2])
    space = space_of(symbology, next(iter(SYMBOLS[symbology].sizes)))
    config = DecodeConfig(min_confidence=1.0 - 1.0 / (ODDS + 1.0), wrong_grids=1.0)
    found = 0
    for _ in range(count):
        q = rng.choice(np.array([-1.0, 1.0], np.float32), space.shape)
        found += isinstance(decode_grid(q, space, config=config), Decoded)
    return found, space


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--grids", type=int, default=1_000_000, help="of all symbologies together")
    parser.add_argument("--symbols", type=int, default=5000, help="distinct ones of each symbology")
    parser.add_argument("--coins", type=int, default=20_000, help="grids of coins of each symbology")
    parser.add_argument("--log", type=Path, help="JSON lines to append to, and to go on from")
    parser.add_argument("--symbologies", help="such as qr,datamatrix; default all")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    chosen = list(SYMBOLS)
    if arguments.symbologies:
        chosen = [Symbology.parse(name) for name in arguments.symbologies.split(",")]
    rounds = max(1, arguments.symbols // A_ROUND)
    each = max(1, arguments.grids // (len(chosen) * rounds * A_ROUND))
    done: dict[tuple[str, int], dict] = {}
    if arguments.log is not None and arguments.log.exists():
        lines = map(json.loads, arguments.log.read_text().splitlines())
        done = {(one["symbology"], one["number"]): one for one in lines if one["seed"] == arguments.seed}
    work = [(symbology, number) for number in range(rounds) for symbology in chosen]
    for symbology, number in tqdm(work, unit="round", disable=None):
        if (symbology.value, number) in done:
            continue
        done[symbology.value, number] = one = round_of(symbology, number, arguments.seed, each)
        if one["wrong"]:
            tqdm.write(f"WRONG {one}", file=sys.stdout)
        if arguments.log is not None:
            with open(arguments.log, "a", encoding="utf-8") as log:
                log.write(json.dumps(one) + "\n")
    print(
        "| symbology | symbols | grids | read rightly | refused | wrong texts | "
        f"coins | read of them | allowed by the bound |\n{9 * '|---'}|"
    )
    for symbology in chosen:
        of = [one for (name, _), one in done.items() if name == symbology.value]
        right, refused = (sum(one.get(key, 0) for one in of) for key in ("right", "refused"))
        wrong = sum(len(one["wrong"]) for one in of)
        found, space = coins(symbology, arguments.coins, arguments.seed)
        counts = (len(of) * A_ROUND, right + refused + wrong, right, refused, wrong)
        cells = [str(symbology), *(f"{count:,}" for count in counts)]
        cells += [f"{arguments.coins:,} of {space.version}", str(found), f"{arguments.coins / ODDS:.0f}"]
        print(f"| {' | '.join(cells)} |", flush=True)
    return 1 if any(one["wrong"] for one in done.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
