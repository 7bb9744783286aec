"""Cameras at this machine, by whichever package of the extra ``live`` knows them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from evqr.errors import EvqrError, MissingExtra, RecordingError, UsageError
from evqr.live import inivation, usb_cameras
from evqr.live.pieces import Piece
from evqr.live.source import RETRY_S, Reopened

DRIVERS: tuple[tuple[str, Any, Callable[..., Iterator[Piece]]], ...] = (
    ("neuromorphic-drivers", usb_cameras, usb_cameras.camera_pieces),
    ("dv-processing", inivation, inivation.camera_pieces),
)
"""What is asked, one after another: package, what lists its cameras, what opens one."""


@dataclass(frozen=True)
class Plugged:
    """A camera that is plugged in.

    Attributes
    ----------
    serial, model : str
        Its number, and what it is.
    driver : str
        The package that drives it.
    problem : str
        Why it cannot be used; "" where it can.
    """

    serial: str
    model: str
    driver: str
    problem: str = ""


def plugged_in() -> tuple[list[Plugged], list[str]]:
    """Look for cameras.

    Returns
    -------
    cameras : list of Plugged
        Each once, by the first package that knows it.
    problems : list of str
        Why a package could not say.

    Raises
    ------
    MissingExtra
        No package is installed.
    """
    cameras: dict[str, Plugged] = {}
    problems: list[str] = []
    missing: list[MissingExtra] = []
    for name, driver, _ in DRIVERS:
        try:
            for serial, model, problem in driver.listed():
                if serial not in cameras or cameras[serial].problem:
                    cameras[serial] = Plugged(serial, model, name, problem)
        except MissingExtra as error:
            missing.append(error)
        except RecordingError as error:
            problems.append(f"{name}: {error}")
    if len(missing) == len(DRIVERS):
        raise missing[0]
    return list(cameras.values()), problems


class Camera(Reopened):
    """A camera at this machine.

    Parameters
    ----------
    where : str
        ``camera:SERIAL``, or ``camera`` for the first that can be used.
    retry_s : (float, float) [s]
        First and longest time between two tries to open it.

    Raises
    ------
    UsageError
        It is none of these.
    MissingExtra
        No package of the extra ``live`` is installed.
    """

    def __init__(self, where: str, *, retry_s: tuple[float, float] = RETRY_S) -> None:
        super().__init__(where, retry_s)
        _, _, self._serial = where.partition(":")
        if where == "camera:" or not self.meant(where):
            raise UsageError(f"{where}: is no camera; write camera or camera:SERIAL (evqr doctor lists them)")
        plugged_in()  # for what is not installed

    @staticmethod
    def meant(where: str) -> bool:
        """Whether a text names such a source."""
        return where == "camera" or where.startswith("camera:")

    def _opened(self) -> Iterator[Piece]:
        cameras, problems = plugged_in()
        fit = [each for each in cameras if self._serial in ("", each.serial)]
        usable = [each for each in fit if not each.problem]
        if not usable:
            said = [f"{each.model} {each.serial}: {each.problem}" for each in fit] or problems
            there = ", ".join(each.serial for each in cameras)
            found = f"no camera {self._serial} is".replace("  ", " ") + " plugged in"
            raise RecordingError("; ".join([found + (f", there is {there}" if there else ""), *said]))
        (opens,) = (opens for name, _, opens in DRIVERS if name == usable[0].driver)
        yield from opens(usable[0].serial, self._stopped)


def describe_cameras() -> str:
    """Say in a line what is plugged in.

    Returns
    -------
    text : str
        Models and numbers, or why there is none.
    """
    try:
        cameras, problems = plugged_in()
    except EvqrError as error:
        return str(error)
    named = [f"{each.model} camera:{each.serial} by {each.driver}" for each in cameras if not each.problem]
    wrong = [f"{each.model} {each.serial}: {each.problem}" for each in cameras if each.problem]
    return "; ".join([*named, *wrong, *problems]) or "none is plugged in"
