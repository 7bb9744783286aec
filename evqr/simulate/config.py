"""What is simulated: the scene and the sensor, and the presets."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from evqr.errors import UsageError
from evqr.simulate.qr_writer import charset_of, gs1_message
from evqr.symbol.payload import StructuredAppend
from evqr.symbol.space import Version
from evqr.symbol.symbols import SYMBOLS
from evqr.symbology import Symbology

EcLevel = Literal["L", "M", "Q", "H"]

#: The number of masks of symbols that have some to choose from.
MASKS: Mapping[Symbology, int] = MappingProxyType({Symbology.QR_CODE: 8, Symbology.MICRO_QR_CODE: 4})

#: Symbols with levels of error correction.
WITH_LEVELS = frozenset({Symbology.QR_CODE, Symbology.MICRO_QR_CODE, Symbology.RMQR_CODE})


def _require(ok: bool, name: str, value: object, wanted: str) -> None:
    if not ok:
        raise UsageError(f"simulate: {name} is {value!r}, but must be {wanted}")


@dataclass(frozen=True, kw_only=True)
class CodePlacement:
    """One printed code and its place on the moving object.

    Attributes
    ----------
    text : str
        Payload, not empty.
    symbology : Symbology or str
        "QRCode", "MicroQRCode", "RMQRCode", "DataMatrix" or "Aztec", in any case.
    version : Version, optional
        1 to 40, M1 to M4, R7x43 to R17x139, as 22x22, or C1 to C4 and F1 to F32; None:
        the smallest that holds the text.
    ec : EcLevel
        Error correction level "L", "M", "Q" or "H"; M1, Data Matrix and Aztec have none,
        rMQR codes "M" and "H".
    mask : int, optional
        0 to 7, or 0 to 3; None: chosen as the standard says.
    module_px : float [px]
        Width of a module, 1 to 100.
    angle : float [deg]
        Of the code's u axis against the image's x axis, towards +y.
    offset_px : (float, float) [px]
        Of the code's centre from the object's centre: along the travel, across it.
    invert : bool
        Print light on dark.
    gs1 : bool
        A GS1 message (QR codes only): ``(01)09506000134352(10)LOT42``, or with separators (0x1d).
    eci : int, optional
        ECI designator, 0 to 999999, which names the character set of the text (QR codes only); None: none.
    charset : str, optional
        Character set in which the text is written, as utf-8; None: that of the ECI, or the first of
        ISO 8859-1, Shift JIS and UTF-8 that has the text. With "latin-1" a text can be any bytes.
    append : StructuredAppend, optional
        Which part of a message it is (QR codes only).
    application : str, optional
        Application indicator of AIM, two digits or a letter, which stands before the text: FNC1 in second
        position (QR codes only).
    """

    text: str
    symbology: Symbology | str = Symbology.QR_CODE
    version: Version | None = None
    ec: EcLevel = "M"
    mask: int | None = None
    module_px: float = 6.0
    angle: float = 30.0
    offset_px: tuple[float, float] = (0.0, 0.0)
    invert: bool = False
    gs1: bool = False
    eci: int | None = None
    charset: str | None = None
    append: StructuredAppend | None = None
    application: str | None = None

    def __post_init__(self):
        _require(bool(self.text), "text", self.text, "at least one character")
        _require(self.ec in ("L", "M", "Q", "H"), "ec", self.ec, "one of L, M, Q, H")
        try:
            symbology = Symbology.parse(self.symbology)
        except ValueError as error:
            raise UsageError(f"simulate: {error}") from None
        _require(symbology in SYMBOLS, "symbology", symbology.value, f"one of {', '.join(SYMBOLS)}")
        object.__setattr__(self, "symbology", symbology)
        versions, masks = list(SYMBOLS[symbology].sizes), MASKS.get(symbology, 0)
        wanted = f"{versions[0]} to {versions[-1]}"
        _require(self.version is None or self.version in versions, "version", self.version, wanted)
        wanted = f"0 to {masks - 1}" if masks else f"left out: {symbology} has none to choose from"
        _require(self.mask is None or 0 <= self.mask < masks, "mask", self.mask, wanted)
        _require(1.0 <= self.module_px <= 100.0, "module_px", self.module_px, "1 to 100 px")
        _require(math.isfinite(self.angle), "angle", self.angle, "a finite number of degrees")
        self._check_content(symbology)

    def _check_content(self, symbology: Symbology) -> None:
        beside = {"gs1": self.gs1 or None, "eci": self.eci, "append": self.append}
        beside["application"] = self.application
        if symbology is not Symbology.QR_CODE:
            for name, value in beside.items():
                _require(value is None, name, value, f"left out: {symbology} has none")
        if symbology not in MASKS:
            _require(self.charset is None, "charset", self.charset, f"left out for {symbology}")
        _require(self.eci is None or 0 <= self.eci <= 999_999, "eci", self.eci, "0 to 999999")
        if self.append is not None:
            _require(2 <= self.append.count <= 16, "append", self.append, "of 2 to 16 parts")
            _require(0 <= self.append.index < self.append.count, "append", self.append, "one of its parts")
            _require(0 <= self.append.parity <= 255, "append", self.append, "of a parity from 0 to 255")
        if self.application is not None:
            known = re.fullmatch(r"[0-9]{2}|[A-Za-z]", self.application)
            _require(known is not None, "application", self.application, "two digits or a letter")
            _require(not self.gs1, "application", self.application, "left out with gs1")
        if self.gs1:
            object.__setattr__(self, "text", gs1_message(self.text))
        try:
            self.text.encode(charset_of(self.charset, self.eci) or "utf-8")
        except (LookupError, ValueError):
            raise UsageError(f"simulate: charset {self.charset!r} does not write {self.text!r}") from None


@dataclass(frozen=True, kw_only=True)
class SceneConfig:
    """A flat object with printed codes that crosses a still background at constant speed.

    Attributes
    ----------
    codes : tuple of CodePlacement
        Printed on the object; none: barcodes, text and boxes that are no code instead.
    width, height : int [px]
        Of the sensor.
    direction : float [deg]
        Of travel in the image, from +x towards +y.
    speed_px_ms : float [px/ms]
        Speed at the centre of the view, above 0.
    start : (float, float) [px], optional
        (x, y) of the object's centre at t = 0; None: half of the travel puts it at the centre of the
        view.
    duration_us : int [us], optional
        Length of the recording; None: 40 px of travel, or the whole passage of several codes that
        the view does not hold together.
    turn_radius_px : float [px], optional
        The object turns with a turntable, clockwise in the image, its centre so far from the axis; at the
        middle of the recording, or at t = 0 where ``start`` is given, it travels in ``direction`` and its
        codes have their angles. It turns once at most. None: it moves straight.
    tilt : float [deg]
        Of the object's plane against the image plane, below 60.
    tilt_axis : float [deg]
        The axis it is tilted about, an angle in the image.
    focal_px : float [px]
        Focal length, which says how strong the perspective of a tilt is.
    white, black : float
        Light from the code's light and dark modules, relative to full light, 0 to 1.
    psf_px : float [px]
        Standard deviation of the optics' and the pixel's blur, at least 0.3.
    seed : int
        Of textures and noise.
    """

    codes: tuple[CodePlacement, ...] = ()
    width: int = 640
    height: int = 480
    direction: float = 0.0
    speed_px_ms: float = 4.0
    start: tuple[float, float] | None = None
    duration_us: int | None = None
    turn_radius_px: float | None = None
    tilt: float = 0.0
    tilt_axis: float = 35.0
    focal_px: float = 1000.0
    white: float = 0.85
    black: float = 0.10
    psf_px: float = 0.6
    seed: int = 0

    def __post_init__(self):
        _require(16 <= self.width <= 4096, "width", self.width, "16 to 4096 px")
        _require(16 <= self.height <= 4096, "height", self.height, "16 to 4096 px")
        _require(0.001 <= self.speed_px_ms <= 1000.0, "speed_px_ms", self.speed_px_ms, "0.001 to 1000 px/ms")
        _require(math.isfinite(self.direction), "direction", self.direction, "a finite number of degrees")
        _require(abs(self.tilt) < 60.0, "tilt", self.tilt, "below 60 degrees")
        _require(self.duration_us is None or self.duration_us > 0, "duration_us", self.duration_us, "above 0")
        radius = self.turn_radius_px
        _require(radius is None or 1.0 <= radius <= 1e5, "turn_radius_px", radius, "1 to 100000 px")
        _require(self.focal_px >= 100.0, "focal_px", self.focal_px, "at least 100 px")
        _require(
            0.0 < self.black < self.white <= 1.0,
            "black, white",
            (self.black, self.white),
            "0 < black < white <= 1",
        )
        _require(0.3 <= self.psf_px <= 10.0, "psf_px", self.psf_px, "0.3 to 10 px")
        _require(self.seed >= 0, "seed", self.seed, "0 or more")


@dataclass(frozen=True, kw_only=True)
class SensorConfig:
    """An event camera: its pixels, then its noise, then its readout.

    Attributes
    ----------
    threshold : float [log units]
        Log-intensity step of an ON event, mean over the pixels.
    off_to_on : float
        Mean OFF threshold over mean ON threshold.
    threshold_spread : float [log units]
        Standard deviation of both over the pixels.
    tau_us : float [us]
        Time constant of the photoreceptor at full light (1.0); 0: no lag.
    tau_follows_light : bool
        Time constant inversely proportional to the light: dark pixels are slow.
    refractory_us : float [us]
        Time a pixel is held in reset after an event.
    leak_hz : float [Hz]
        ON events a second and pixel that the leaking reference causes.
    background_hz : float [Hz]
        Background activity: random events a second and pixel, both polarities alike.
    hot_fraction : float
        Share of the pixels that are hot.
    hot_hz : float [Hz]
        Random events a second of a hot pixel, all of one polarity.
    drop_rate : float
        Share of the events that is lost.
    jitter_us : float [us]
        Standard deviation of the time stamps.
    row_scan_us : float [us]
        Time to scan all rows once; an event leaves when its row is next read; 0: at once.
    readout_meps : float [million/s]
        Events the readout carries; 0: any number.
    readout_queue_us : float [us]
        Events wait for the readout about this long before they are lost.
    """

    threshold: float = 0.2
    off_to_on: float = 1.0
    threshold_spread: float = 0.0
    tau_us: float = 0.0
    tau_follows_light: bool = True
    refractory_us: float = 0.0
    leak_hz: float = 0.0
    background_hz: float = 0.0
    hot_fraction: float = 0.0
    hot_hz: float = 2000.0
    drop_rate: float = 0.0
    jitter_us: float = 0.0
    row_scan_us: float = 0.0
    readout_meps: float = 0.0
    readout_queue_us: float = 200.0

    def __post_init__(self):
        _require(0.01 <= self.threshold <= 2.0, "threshold", self.threshold, "0.01 to 2 log units")
        _require(0.1 <= self.off_to_on <= 10.0, "off_to_on", self.off_to_on, "0.1 to 10")
        _require(0.0 <= self.hot_fraction <= 1.0, "hot_fraction", self.hot_fraction, "0 to 1")
        _require(0.0 <= self.drop_rate < 1.0, "drop_rate", self.drop_rate, "0 to less than 1")
        _require(self.readout_queue_us > 0.0, "readout_queue_us", self.readout_queue_us, "above 0")
        for name in (
            "threshold_spread",
            "tau_us",
            "refractory_us",
            "leak_hz",
            "background_hz",
            "hot_hz",
            "jitter_us",
            "row_scan_us",
            "readout_meps",
        ):
            value = getattr(self, name)
            _require(0.0 <= value < math.inf, name, value, "0 or more")


#: Sensors by name.
#:
#: ``clean``  an ideal sensor: equal thresholds of 0.2, no lag, no noise, unlimited readout
#: ``slow``   a good sensor in good light, for slow scenes
#: ``fast``   a bright scene at speed: pixels lag, events are noisy and some are lost
#: ``hard``   as fast, in less light: strong lag, heavy noise, nearly half of the events lost, a slow readout
#:
#: Thresholds of 0.2 with a spread of 0.03 and a bandwidth that follows the light are v2e's (Hu, Liu,
#: Delbruck, "v2e: From Video Frames to Realistic DVS Events", CVPR workshops 2021); 300 million events a
#: second is the readout of the paper's sensor (Son et al., "A 640x480 dynamic vision sensor with a 9 um
#: pixel and 300 Meps address-event representation", ISSCC 2017).
PRESETS: Mapping[str, SensorConfig] = MappingProxyType(
    {
        "clean": SensorConfig(),
        "slow": SensorConfig(
            threshold_spread=0.03,
            off_to_on=1.15,
            tau_us=60.0,
            refractory_us=50.0,
            leak_hz=0.1,
            background_hz=3.0,
            hot_fraction=2e-4,
            drop_rate=0.10,
            jitter_us=15.0,
            readout_meps=300.0,
        ),
        "fast": SensorConfig(
            threshold_spread=0.03,
            off_to_on=1.25,
            tau_us=60.0,
            refractory_us=60.0,
            leak_hz=0.1,
            background_hz=8.0,
            hot_fraction=5e-4,
            drop_rate=0.25,
            jitter_us=25.0,
            readout_meps=300.0,
        ),
        "hard": SensorConfig(
            threshold=0.25,
            threshold_spread=0.05,
            off_to_on=1.4,
            tau_us=120.0,
            refractory_us=100.0,
            leak_hz=0.3,
            background_hz=30.0,
            hot_fraction=1e-3,
            drop_rate=0.40,
            jitter_us=50.0,
            row_scan_us=40.0,
            readout_meps=60.0,
        ),
    }
)

#: Speed that `simulate` gives a preset's scene when none is asked for [px/ms].
PRESET_SPEEDS_PX_MS: Mapping[str, float] = MappingProxyType(
    {"clean": 4.0, "slow": 2.0, "fast": 8.0, "hard": 8.0}
)


def sensor_of(preset: str | SensorConfig) -> SensorConfig:
    """Return the sensor of a preset's name, or the sensor itself; raise UsageError for an unknown name."""
    if isinstance(preset, SensorConfig):
        return preset
    if preset not in PRESETS:
        raise UsageError(f"simulate: unknown preset {preset!r}; choose one of {', '.join(PRESETS)}")
    return PRESETS[preset]
