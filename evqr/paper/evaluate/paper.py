"""The numbers of the paper's Table 1 (Nagata et al., WACV 2020), as printed."""

from __future__ import annotations

import functools
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Printed:
    """One line of the paper's table; None where it prints a dash.

    Attributes
    ----------
    trials : int
        N.
    mode_accuracy, max_accuracy : float [%], optional
        Share of modules that are right: of the mode over the trials, of the best trial.
    seconds_to_read, iterations_to_read : float, optional
        Until the text was read [s], and in iterations.
    read_rate, image_read_rate : float [%], optional
        Share of the trials that were read, by the method and from its image.
    """

    trials: int
    mode_accuracy: float | None
    seconds_to_read: float | None
    iterations_to_read: float | None
    max_accuracy: float | None
    read_rate: float | None
    image_read_rate: float | None


_TABLE = """
#scene     method      deg    N  mode  seconds  iterations   max  read  zxing
faster     image         0   12     -        -           -     -     -      0
faster     image        30   12     -        -           -     -     -      0
faster     image        45   12     -        -           -     -     -      0
faster     bardow        0   22    50        -           -  88.7     0      0
faster     bardow       30   22  85.9        -           -  91.2     0      0
faster     bardow       45   22    50        -           -  82.6     0      0
faster     without_qr    0  150    50      1.3        63.9    99  8.77      0
faster     without_qr   30  150  65.6     2.15         105  98.5     4      2
faster     without_qr   45  150    61      3.5         168  95.3   1.3      2
faster     descent       0  150  99.2     0.75        12.6   100  92.7      -
faster     descent      30  150  99.5     0.34        6.04   100  96.7      -
faster     descent      45  150  99.7      0.2        4.16   100  99.2      -
slower     image         0    4  66.4        -           -  67.9     0      0
slower     image        30    4  67.9        -           -    69     0      0
slower     image        45    4  63.8        -           -  64.3     0      0
slower     bardow        0  172  99.5     40.4        65.2   100   100   16.9
slower     bardow       30  172  99.2     10.7        17.2   100   100   11.6
slower     bardow       45  172    99     21.1        33.5   100   100   1.16
slower     without_qr    0  300  98.2        1        42.4   100  56.9   0.67
slower     without_qr   30  300  99.7     0.78        28.7  99.7  91.2   55.3
slower     without_qr   45  300   100     1.07          44    99  72.6   1.67
slower     descent       0  300  97.9     1.38        19.6   100  73.1      -
slower     descent      30  300  99.7      0.6        9.05   100    88      -
slower     descent      45  300   100     0.33        5.51   100  96.9      -
simulator  image         0    5  76.2        -           -  76.2     0      0
simulator  image        30    5    90        -           -    90     0      0
simulator  image        45    5  92.6        -           -  92.6     0      0
simulator  bardow        0  272  52.3      127         195  99.7  63.6      0
simulator  bardow       30  272   100     6.11        9.17   100   100    100
simulator  bardow       45  272   100     9.51          14   100   100   77.6
simulator  without_qr    0  400  97.9     0.51        19.6    99    99      0
simulator  without_qr   30  400   100     0.63        25.5   100  95.8   77.5
simulator  without_qr   45  400   100      0.6        19.7   100   100   3.25
simulator  descent       0  400  87.7     0.78        10.6   100  48.2      -
simulator  descent      30  400   100     0.15        3.18   100   100      -
simulator  descent      45  400   100     0.14           3   100  99.1      -
"""


def printed(scene: str, method: str, angle: float) -> Printed | None:
    """Return what the paper prints for a cell; None where it has no such cell."""
    return _lines().get((scene, method, angle))


@functools.cache
def _lines() -> dict[tuple[str, str, float], Printed]:
    lines = {}
    for line in _TABLE.strip().splitlines()[1:]:
        scene, method, angle, trials, *rest = line.split()
        mode, seconds, iterations, best, read, image = (None if n == "-" else float(n) for n in rest)
        lines[scene, method, float(angle)] = Printed(
            trials=int(trials),
            mode_accuracy=mode,
            seconds_to_read=seconds,
            iterations_to_read=iterations,
            max_accuracy=best,
            read_rate=read,
            image_read_rate=image,
        )
    return lines
