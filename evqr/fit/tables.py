"""What kernels are told of the kinds and sizes of codes: of all that were asked for, in the same arrays.

So poses and windows of different codes share a launch, each with the number of its code, and a sequence that
was recorded serves codes that are asked for later.  Number 0 is no code: a window or a pose of it costs
nothing, and what comes out means nothing.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.config import AlignConfig, ModulesConfig
from evqr.fit.model import MOMENTS, lattices, pose_table, quiet_modules
from evqr.symbol.space import CodeSpace
from evqr.workspace import Mirror, Staging, Workspace

REACH = 2
"""Modules on either side that a module meets in the normal matrix."""

BLOCK = 8
"""Neighbouring modules that a kernel takes together: the last of a row may reach so far beyond the code."""

SETTINGS = 7
"""Numbers that `align_poses` is told of a table."""

ROOM = {"M": 8, "S": 1 << 12, "side": 48}
"""Codes, samples of them all, and modules along an axis with those around it, that there is room for at
first."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One step from coarse to fine.

    Attributes
    ----------
    sigma : float [modules]
        Blur of the model.
    samples : int
        Samples a module.
    tilt : bool
        Whether perspective is free where there is more than one finder pattern to hold it.
    tolerance : float [modules]
        Step at which it has converged.
    beyond_patterns : bool
        Whether only what is known outside of finder patterns counts.
    """

    sigma: float
    samples: int
    tilt: bool
    tolerance: float
    beyond_patterns: bool = False


_versions = itertools.count()


class Codes:
    """Numbers of codes, and tables of them; one for a workspace."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._spaces: list[CodeSpace | None] = [None]
        self._numbers: dict[CodeSpace, int] = {}
        self._rooms: dict[frozenset[int], tuple[int, int]] = {}

    @classmethod
    def of(cls, workspace: Workspace) -> Codes:
        """Give those of a workspace."""
        return workspace.once(("codes",), lambda: cls(workspace))

    def number(self, space: CodeSpace) -> int:
        """Give the number of a code."""
        try:
            return self._numbers[space]
        except KeyError:
            self._numbers[space] = len(self._spaces)
            self._spaces.append(space)
            return self._numbers[space]

    def numbers(self, spaces: Iterable[CodeSpace]) -> list[int]:
        """Give the numbers of codes."""
        numbers: list[int] = []
        last, number = None, 0
        for space in spaces:
            if space is not last:  # most often all are alike
                last, number = space, self.number(space)
            numbers.append(number)
        return numbers

    def space(self, number: int) -> CodeSpace:
        """Give the code that has a number."""
        space = self._spaces[number]
        assert space is not None
        return space

    def room(self, numbers: Iterable[int]) -> tuple[int, int]:
        """Give rows and columns of arrays in which any of some codes lie: see `room_for`."""
        which = frozenset(numbers)
        try:
            return self._rooms[which]
        except KeyError:
            self._rooms[which] = room_for([self.space(number) for number in which])
            return self._rooms[which]

    def poses(self, level: Level, cfg: AlignConfig, numbers: Iterable[int]) -> PoseTables:
        """Give the tables of one level, with some codes in them."""
        key = "pose tables", level, cfg.ridge, cfg.damping
        tables = self._workspace.once(key, lambda: PoseTables(level, cfg, self._workspace))
        tables.hold(self, numbers)
        return tables

    def modules(self, cfg: ModulesConfig, numbers: Iterable[int]) -> ModuleTables:
        """Give what stage two is told, of some codes."""
        key = "module tables", cfg.samples, cfg.unclear
        tables = self._workspace.once(key, lambda: ModuleTables(cfg, self._workspace))
        tables.hold(self, numbers)
        return tables


class Tables:
    """Arrays with an entry a code, in which there is room for more.

    Attributes
    ----------
    version : int
        Of these arrays alone: what works on them is to be made anew where it is another one.
    """

    def __init__(self, workspace: Workspace, room: dict[str, int]) -> None:
        self._workspace = workspace
        self._room = room
        self._held: set[int] = {0}
        self.version = next(_versions)
        self._mirrors = self._made()

    def hold(self, codes: Codes, numbers: Iterable[int]) -> None:
        """See to it that codes are there."""
        if self._held.issuperset(numbers):
            return
        for number in sorted(set(numbers) - self._held):
            self._add(number, codes.space(number))
            self._held.add(number)
        self._staging.push()

    def __getitem__(self, name: str) -> Any:
        return self._mirrors[name].device

    def _add(self, number: int, space: CodeSpace) -> None:
        raise NotImplementedError

    def _shapes(self) -> dict[str, tuple[tuple[int, ...], type]]:
        raise NotImplementedError

    def _made(self) -> dict[str, Mirror]:
        self._staging = Staging(self._workspace)
        return {name: self._staging.input(shape, dtype) for name, (shape, dtype) in self._shapes().items()}

    def _grow(self, **needed: int) -> None:
        """Make room for so much; what was there stays."""
        if all(self._room[name] >= size for name, size in needed.items()):
            return
        for name, size in needed.items():
            while self._room[name] < size:
                self._room[name] *= 2
        before, self._mirrors = self._mirrors, self._made()
        for name, mirror in before.items():
            self._mirrors[name].host[tuple(map(slice, mirror.host.shape))] = mirror.host
        self.version = next(_versions)


class PoseTables(Tables):
    """What `align_poses` takes of one level: see `PoseTable`."""

    def __init__(self, level: Level, cfg: AlignConfig, workspace: Workspace) -> None:
        self._level, self._cfg = level, cfg
        self._end = 0
        super().__init__(workspace, {"M": ROOM["M"], "S": ROOM["S"]})
        # of no code there are no points; so that the gain is 0 and the pose stays:
        self._mirrors["gram"].host[0] = np.eye(MOMENTS)
        self._mirrors["settings"].host[0] = 0.0, 0.0, 1.0, 1.0, cfg.ridge, cfg.damping, level.tolerance
        terms, factors = terms_of(level.tilt)
        self._terms = workspace.table(("terms", level.tilt), terms)
        self._factors = workspace.table(("factors", level.tilt), factors)

    def _shapes(self) -> dict[str, tuple[tuple[int, ...], type]]:
        codes, samples = self._room["M"], self._room["S"]
        return {
            "points": ((samples, 2), np.float32),
            "table": ((samples, MOMENTS), np.float32),
            "table_ptr": ((codes, 2), np.int32),
            "gram": ((codes, MOMENTS, MOMENTS), np.float32),
            "parameters": ((codes,), np.int32),
            "settings": ((codes, SETTINGS), np.float32),
        }

    def _add(self, number: int, space: CodeSpace) -> None:
        level, cfg = self._level, self._cfg
        made = pose_table(space, level.sigma, level.samples, level.beyond_patterns)
        end = self._end + len(made.points)
        self._grow(M=number + 1, S=end)
        host = {name: mirror.host for name, mirror in self._mirrors.items()}
        host["points"][self._end : end] = made.points
        host["table"][self._end : end] = made.table
        host["table_ptr"][number] = self._end, end
        host["gram"][number] = made.gram
        host["parameters"][number] = 8 if level.tilt and not space.single_pattern else 6
        host["settings"][number] = *made.centre, *made.scale, cfg.ridge, cfg.damping, level.tolerance
        self._end = end

    @property
    def arguments(self) -> tuple[Any, ...]:
        """Arrays on the device, as `align_poses` takes them behind ``table_idx``."""
        return (
            self["points"], self["table"], self["table_ptr"], self["gram"], self._terms, self._factors,
            self["parameters"], self["settings"],
        )  # fmt: skip


class ModuleTables(Tables):
    """What `code_rhs` and `solve_code` take of codes, whose modules lie amid those of their quiet zone."""

    def __init__(self, cfg: ModulesConfig, workspace: Workspace) -> None:
        self._samples, self._share = cfg.samples, cfg.unclear
        super().__init__(workspace, {"M": ROOM["M"], "side": ROOM["side"]})

    def _shapes(self) -> dict[str, tuple[tuple[int, ...], type]]:
        codes, side = self._room["M"], self._room["side"]
        return {
            "lattice_u": ((codes, side * self._samples), np.float32),
            "lattice_v": ((codes, side * self._samples), np.float32),
            "sides": ((codes, 2), np.int32),
            "free": ((codes, side, side), np.int32),
            "start": ((codes, side, side), np.float32),
            "bounds": ((codes, 4), np.int32),
            "enough": ((codes,), np.int32),
        }

    def _add(self, number: int, space: CodeSpace) -> None:
        quiet = quiet_modules(space)
        free, start = fixed(space)
        rows, columns = free.shape
        self._grow(M=number + 1, side=max(room_for([space])))  # what is solved takes that much of `start`
        host = {name: mirror.host for name, mirror in self._mirrors.items()}
        across, down = lattices(space, self._samples)
        host["lattice_u"][number, : len(across)] = across
        host["lattice_v"][number, : len(down)] = down
        host["sides"][number] = rows, columns
        host["free"][number, :rows, :columns] = free
        host["bounds"][number] = quiet, rows - quiet, quiet, columns - quiet
        host["enough"][number] = int(self._share * space.known.size)
        host["start"][number, :rows, :columns] = start


@functools.cache
def fixed(space: CodeSpace) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Which modules are free, and q - 1 to start from: known values, and the middle where free.

    Both (V + 2 quiet, U + 2 quiet).
    """
    quiet = quiet_modules(space)
    free = np.pad(~space.known, quiet).astype(np.int32)
    start = np.pad(np.where(space.known, space.values - 1.0, -1.0), quiet).astype(np.float32)
    return free, start


def room_for(spaces: Sequence[CodeSpace]) -> tuple[int, int]:
    """Give rows and columns of arrays in which any of some codes lie, with the modules around it.

    The last modules of a row are solved for together with some beyond them, and all meet their neighbours:
    with room for these, what is beyond makes no difference.
    """
    rows = max(space.rows + quiet_modules(space) + max(quiet_modules(space), REACH) for space in spaces)
    columns = max(
        quiet_modules(space) + -(-space.columns // BLOCK) * BLOCK + max(quiet_modules(space), REACH)
        for space in spaces
    )
    return rows, -(-columns // BLOCK) * BLOCK


@functools.cache
def terms_of(tilt: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Give the table's columns that make up each of the Jacobian's, and their factors, (P + 2, 4) each.

    Factors: 0 nothing, 1 a_u, 2 a_v, 3 one.
    """
    uu, uv, vv = 0, 5, 12  # where L_uu, L_uv, L_vv start in the table
    rows: list[tuple[tuple[int, int], ...]] = [((uu + w, 1), (uv + w, 2)) for w in range(3)]
    rows += [((uv + w, 1), (vv + w, 2)) for w in range(3)]
    if tilt:
        for w in (3, 4):  # w_u u', w_u v' with L_uu and L_uv; w_v u', w_v v' with L_uv and L_vv
            rows.append(((uu + w, 1), (uv + w, 2), (uv + w + 2, 1), (vv + w, 2)))
    rows += [((MOMENTS - 2, 3),), ((MOMENTS - 1, 3),)]
    padded = np.array([[*row, *[(0, 0)] * (4 - len(row))] for row in rows], np.int32)
    return np.ascontiguousarray(padded[..., 0]), np.ascontiguousarray(padded[..., 1])
