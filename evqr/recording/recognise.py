"""Which format a file is in, by what is in it; its name is never asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import RecordingError
from .options import Asked
from .source import Source, refusal

HEAD_BYTES = 4096

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
MATLAB_BLOCK = 512  # MATLAB writes text of this length before HDF5

UNSUPPORTED = {
    b"#!AER-DAT": (
        "AEDAT before version 3 is not read: its readers disagree on the corner where x and y begin, which"
        " mirrors codes; write it as text, a line t x y p an event, with the program that shows it right"
    ),
    b"Event Stream": (
        "Event Stream (.es) is not read; convert it with faery: pip install faery, then"
        " faery input file IN.es output file OUT.aedat4"
    ),
    b"\x1f\x8b": "the file is compressed with gzip; unpack it first",
    b"MATLAB 5.0": "MATLAB files before version 7.3 are not read; save it with save(..., '-v7.3')",
}

# Keys of header lines: those that only Prophesee's RAW files have, and those that DAT files have.
RAW_KEYS = (
    b"evt ",
    b"format evt",
    b"system_id",
    b"integrator_name",
    b"camera_integrator_name",
    b"plugin_name",
)
DAT_KEYS = (b"version", b"width", b"height", b"geometry", b"date", b"data file", b"end", b"format")

Reader = Callable[[str, Asked], Source]


def reader_of(path: str) -> Reader:
    """Return the reader of a file; readers are imported only when needed.

    Raises
    ------
    RecordingError
        For what is no file with bytes in it, or of no format that is read.
    """
    with _looking_at(path):
        bag = _ros2_bag(path)
    if bag:
        from .rosbag import BagSource

        return lambda _, asked: BagSource(bag, asked)
    head = _head(path)
    if head.startswith(HDF5_MAGIC) or head.startswith(HDF5_MAGIC, MATLAB_BLOCK):
        from .hdf5 import Hdf5Source as reader
    elif head.startswith(b"PK\x03\x04"):
        from .numpy_files import NpzSource as reader
    elif head.startswith(b"\x93NUMPY"):
        from .numpy_files import NpySource as reader
    elif head.startswith(b"#!AER-DAT4"):
        from .aedat4 import Aedat4Source as reader
    elif head.startswith(b"#!AER-DAT3"):
        from .aedat3 import Aedat3Source as reader
    elif head.startswith((b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0")):
        from .rosbag import BagSource as reader
    elif advice := next((text for magic, text in UNSUPPORTED.items() if head.startswith(magic)), None):
        raise RecordingError(f"{path}: {advice}")
    elif _has_key(head, RAW_KEYS):
        from .prophesee import open_prophesee as reader
    elif _is_text(head):
        from .text import TextSource as reader
    elif _has_key(head, DAT_KEYS):
        from .prophesee import open_prophesee as reader
    else:
        raise RecordingError(
            f"{path}: not an event recording (starts with {head[:16]!r}); known are HDF5, npz, npy, text,"
            " Prophesee RAW and DAT, AEDAT and ROS bags"
        )
    return reader


@contextmanager
def _looking_at(path: str) -> Iterator[None]:
    """Turn what the system says no to into an error of one line."""
    try:
        yield
    except OSError as error:
        problem = refusal(error) or f"cannot be read ({error.strerror or error})"
        raise RecordingError(f"{path}: {problem}") from error


def _ros2_bag(path: str) -> str | None:
    """Return what to open of a folder that is a ROS 2 bag: itself, or its one file without metadata."""
    place = Path(path)
    if not place.is_dir():
        return None
    if (place / "metadata.yaml").is_file():
        return path
    files = [file for file in place.iterdir() if file.suffix in (".db3", ".mcap")]
    return str(files[0]) if len(files) == 1 else None


def _head(path: str) -> bytes:
    """First bytes of a file, with an error for whatever is no file with bytes in it."""
    place = Path(path)
    with _looking_at(path):
        if not place.exists():
            raise RecordingError(f"{path}: no such file; check the path")
        if place.is_dir():
            raise RecordingError(f"{path}: is a directory; name a recording in it")
        if not place.is_file():
            raise RecordingError(
                f"{path}: is a pipe or a device, and files are read; save it to a file first"
            )
        with open(path, "rb") as file:
            head = file.read(HEAD_BYTES)
    if not head:
        raise RecordingError(f"{path}: the file is empty (0 bytes); copy or record it again")
    return head


def _is_text(head: bytes) -> bool:
    """Whether it is printable, and its lines no longer than lines are."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):  # what Windows calls Unicode
        head = head.decode("utf-16", "replace").encode()
    printable = all(byte >= 0x20 or byte in b"\t\r\n" for byte in head)
    return printable and (b"\n" in head or b"\r" in head or len(head) < HEAD_BYTES)


def _has_key(head: bytes, keys: tuple[bytes, ...]) -> bool:
    """Whether there are header lines such as ``% evt 3.0`` before the data."""
    at = 0
    while head.startswith(b"% ", at):
        end = head.find(b"\n", at)
        line = head[at + 2 : end if end >= 0 else None].strip().lower()
        if line.startswith(keys):
            return True
        if end < 0 or line == b"end":
            break
        at = end + 1
    return False
