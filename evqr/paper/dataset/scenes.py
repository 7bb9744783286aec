"""The 18 scenes: three kinds of scene at three angles with two texts.

The paper's data set was never published; its own figures fix the geometry.  N windows of dt at the train's
speed are the travel in view: 150 x 0.25 ms x 2 m/s = 75 mm, 300 x 0.5 ms x 0.35 m/s = 52 mm.  A code of 25 mm
is 35 mm wide at 45 degrees, and 75 + 35 = 110 mm is the field of view, 640 px wide, so a module of 1 mm is
5.8 px and the motion in one window 2.9 and 1.0 px.  For the simulator the paper gives no length; 400 windows
of 1.25 px leave room for modules of 3.9 px.

What the paper does not say, and what is chosen here, with the paper's own rows as evidence:

- *sensors*: the simulator has none of a sensor's faults.  The slower train has the noise of a good sensor in
  good light.  The faster one has what the paper calls late events and trajectories that are not straight:
  pixels that lag (dark ones more), refractory time, heavy noise, lost events, and a readout that scans rows.
  The readout's queue is there, but these scenes fill it little: it delays by microseconds, the scan and the
  lag by tens and hundreds.
- *exposures* of the frame cameras: the shortest that explain that the paper's cameras read nothing.
- *contrast, texture, light*: those of `evqr.simulate`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from string import ascii_lowercase

from evqr.errors import UsageError
from evqr.simulate.config import PRESETS, CodePlacement, SceneConfig, SensorConfig
from evqr.symbol.qr_codewords import ErrorLevel

VERSION = 2
LEVEL: ErrorLevel = "H"
ANGLES = (0, 30, 45)
TEXTS = ("QRECD-A: CODE IN", "QRECD-B: ON RAILS")


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """A frame camera that looks at the same scene.

    Attributes
    ----------
    fps : float
        Frames a second.
    exposure_us : int [us]
        Time over which a frame collects light.
    read_noise : float [grey levels of 255]
        Standard deviation of a pixel.
    white : float
        Grey level of full light.
    """

    fps: float
    exposure_us: int
    read_noise: float = 2.0
    white: float = 230.0


@dataclass(frozen=True, kw_only=True)
class SceneKind:
    """One of the paper's three kinds of scene.

    Attributes
    ----------
    name : str
        As in the paper's table.
    windows : int
        N of the paper: windows in which the code is in view.
    window_us : int [us]
        Dt of the paper.
    speed_px_ms : float [px/ms]
        Of the code in the image.
    module_px : float [px]
        Width of a module in the image.
    sensor : SensorConfig
        Of the events.
    camera : CameraConfig
        Of the frames.
    """

    name: str
    windows: int
    window_us: int
    speed_px_ms: float
    module_px: float
    sensor: SensorConfig
    camera: CameraConfig


KINDS = (
    SceneKind(
        name="faster",
        windows=150,
        window_us=250,
        speed_px_ms=11.6,
        module_px=5.75,
        sensor=PRESETS["hard"],
        camera=CameraConfig(fps=330.0, exposure_us=3000),
    ),
    SceneKind(
        name="slower",
        windows=300,
        window_us=500,
        speed_px_ms=2.04,
        module_px=5.75,
        sensor=PRESETS["slow"],
        camera=CameraConfig(fps=30.0, exposure_us=10_000),
    ),
    SceneKind(
        name="simulator",
        windows=400,
        window_us=250,
        speed_px_ms=5.0,
        module_px=3.9,
        sensor=PRESETS["clean"],
        camera=CameraConfig(fps=30.0, exposure_us=2000, read_noise=0.0),
    ),
)


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """One scene of the data set, and all that it is made from.

    Attributes
    ----------
    kind : SceneKind
        Of which the scene is one.
    angle : int [deg]
        Of the code against the direction of travel.
    text : str
        What the code says.
    letter : str
        Of the text among those of the data set.
    windows : int
        Simulated, around the middle of the passage; the kind's own number is the whole passage.
    seed : int
        Of texture and noise.
    """

    kind: SceneKind
    angle: int
    text: str
    letter: str
    windows: int
    seed: int

    @property
    def name(self) -> str:
        """Name of the scene and of its file."""
        return f"{self.kind.name}-{self.angle:02d}-{self.letter}"

    @property
    def scene(self) -> SceneConfig:
        """What is simulated: the code crosses the middle of the view half way through."""
        placement = CodePlacement(
            text=self.text,
            version=VERSION,
            ec=LEVEL,
            module_px=self.kind.module_px,
            angle=float(self.angle),
        )
        return SceneConfig(
            codes=(placement,),
            speed_px_ms=self.kind.speed_px_ms,
            duration_us=self.windows * self.kind.window_us,
            seed=self.seed,
        )


def scenes(
    *, most_windows: int | None = None, texts: Sequence[str] = TEXTS, seed: int = 1
) -> Iterator[SceneSpec]:
    """Give the scenes, nine a text, the first text's first.

    Parameters
    ----------
    most_windows : int, optional
        Simulate no more windows than this; None: the whole passage.
    texts : sequence of str
        Up to 26.
    seed : int
        Of the first scene; those of the others follow.

    Raises
    ------
    UsageError
        More texts than letters to name them by.
    """
    if len(texts) > len(ascii_lowercase):
        raise UsageError(f"dataset: {len(texts)} texts are too many; give up to {len(ascii_lowercase)}")
    for letter, text in zip(ascii_lowercase, texts, strict=False):
        for kind in KINDS:
            for angle in ANGLES:
                windows = kind.windows if most_windows is None else min(kind.windows, most_windows)
                yield SceneSpec(kind=kind, angle=angle, text=text, letter=letter, windows=windows, seed=seed)
                seed += 1
