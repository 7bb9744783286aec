"""A directory among temporary files for what is run: nobody else can write it."""

import os
import stat
import tempfile


def own_directory() -> str:
    """Make the directory, or give the one that is there.

    Raises
    ------
    OSError
        There is no place for temporary files.
    """
    if not hasattr(os, "getuid"):  # temporary files of Windows are the user's own
        place = os.path.join(tempfile.gettempdir(), "evqr-kernels")
        os.makedirs(place, exist_ok=True)
        return place
    place = os.path.join(tempfile.gettempdir(), f"evqr-kernels-{os.getuid()}")
    try:
        os.mkdir(place, 0o700)
    except FileExistsError:
        found = os.lstat(place)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
            place = tempfile.mkdtemp(prefix="evqr-kernels-")
    return place


def why_not_writable(place: str) -> OSError | None:
    """Why nothing can be kept in a directory; None if it can."""
    try:
        with tempfile.TemporaryFile(dir=place) as file:
            file.write(bytes(1 << 16))
    except OSError as error:
        return error
    return None
