"""Settings: what is refused and how it is said, where defaults come from, what travels."""

import ast
import copy
import inspect
import json
import pickle
import re
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path

import numpy as np
import pytest

from evqr import config
from evqr.config import (
    AlignConfig,
    DecodeConfig,
    FinderConfig,
    LagConfig,
    ModulesConfig,
    MotionConfig,
    ReadConfig,
    Settings,
    TrackConfig,
    Vote,
)
from evqr.config.settings import kinds

CLASSES = [
    value
    for value in vars(config).values()
    if isinstance(value, type) and issubclass(value, Settings) and value is not Settings
]


@pytest.mark.parametrize(
    ("cls", "given", "allowed"),
    [
        (ReadConfig, {"window_us": 500.5}, "a whole number, at least 1, or None, got 500.5"),
        (ReadConfig, {"window_us": "1"}, "a whole number, at least 1, or None, got '1'"),
        (ReadConfig, {"max_windows": True}, "a whole number, at least 1, or None, got True"),
        (ReadConfig, {"travel_px": None}, "a number, at least 0.2 and at most 50, got None"),
        (ReadConfig, {"vote": 1}, "one of 'mode', 'soft', 'information', got 1"),
        (ReadConfig, {"lag_us": 300.0}, "a tuple of 2, each a number, .*, or None, got 300.0"),
        (ReadConfig, {"motion": AlignConfig()}, "a MotionConfig, got AlignConfig"),
        (FinderConfig, {"peaks": 12.5}, "a whole number, at least 3 and at most 1024, got 12.5"),
        (TrackConfig, {"baseline": 2.5}, "a whole number, at least 2, got 2.5"),
    ],
)
def test_values_of_the_wrong_type_are_refused(cls, given, allowed):
    (name,) = given
    with pytest.raises(TypeError, match=f"^{name} must be {allowed}"):
        cls(**given)


@pytest.mark.parametrize(
    ("cls", "given", "allowed"),
    [
        (ReadConfig, {"symbologies": ()}, "a tuple, each one of 'QRCode', .*, at least one, got \\(\\)"),
        (ReadConfig, {"symbologies": ("code39",)}, "a tuple, each one of 'QRCode', .*, got \\('code39',\\)"),
        (ReadConfig, {"vote": "sotf"}, "one of 'mode', 'soft', 'information', got 'sotf'"),
        (ReadConfig, {"lag_us": (1.0, 2.0, 3.0)}, "a tuple of 2"),
        (MotionConfig, {"min_peak": 1.5}, "a number, at least 0 and at most 1, got 1.5"),
        (MotionConfig, {"probe_us": 60_000}, "at most longest_us, 50000, got 60000"),
        (FinderConfig, {"largest_module_px": 3}, "at least smallest_module_px, 3.2, got 3.0"),
        (DecodeConfig, {"charset": "klingon"}, "a name, as utf-8 or shift_jis, or None, got 'klingon'"),
        (DecodeConfig, {"charset": "rot13"}, "a name, as utf-8 or shift_jis, or None, got 'rot13'"),
        (DecodeConfig, {"min_confidence": 1.0}, "a number, above 0 and below 1, got 1.0"),
        (ModulesConfig, {"damping_range": (0.5, 0.04)}, "a tuple .* none smaller than the one before"),
        (ModulesConfig, {"damping": float("inf")}, "a number, at least 0, got inf"),
        (LagConfig, {"factors": (0.5, 2.0)}, r"a tuple with 1 among them, got \(0.5, 2.0\)"),
        (LagConfig, {"first_on": (0.5,)}, r"a tuple that begins with 0, no lag, got \(0.5,\)"),
        (FinderConfig, {"unsure_turns": ()}, r"a tuple of at least one, got \(\)"),
    ],
)
def test_values_that_make_no_sense_are_refused(cls, given, allowed):
    (name,) = given
    with pytest.raises(ValueError, match=f"^{name} must be {allowed}") as caught:
        cls(**given)
    assert "\n" not in str(caught.value)


def test_what_means_the_same_is_the_same():
    """Numbers of NumPy, lists, and an enum's value are what they stand for: settings are keys of caches."""
    plain = ReadConfig(window_us=500, travel_px=2.0, lag_us=(300.0, 600.0), vote=Vote.SOFT)
    same = ReadConfig(window_us=np.int64(500), travel_px=2, lag_us=[np.float32(300), 600], vote="soft")
    assert same == plain and hash(same) == hash(plain)
    assert same.vote is Vote.SOFT and type(same.window_us) is int and type(same.travel_px) is float


@pytest.mark.parametrize("cls", CLASSES)
def test_settings_are_plain_data(cls):
    made = cls()
    assert made == copy.deepcopy(made) == pickle.loads(pickle.dumps(made)) == replace(made)
    assert cls.from_dict(json.loads(json.dumps(made.to_dict()))) == made
    with pytest.raises(FrozenInstanceError):
        setattr(made, fields(cls)[0].name, 1)
    with pytest.raises(TypeError):
        cls(getattr(made, fields(cls)[0].name))  # keywords only


def test_a_part_of_the_settings_is_enough():
    given = {"vote": "mode", "finder": {"peaks": 12}, "track": {"patience": 3}}
    made = ReadConfig.from_dict(given)
    assert made == ReadConfig(vote=Vote.MODE, finder=FinderConfig(peaks=12), track=TrackConfig(patience=3))


def test_a_misspelt_setting_is_told():
    with pytest.raises(ValueError, match="ReadConfig has no setting 'widow_us': did you mean 'window_us'"):
        ReadConfig.from_dict({"widow_us": 500})


@pytest.mark.parametrize("cls", CLASSES)
def test_every_field_is_checked(cls):
    """What no annotation allows is refused: no field takes everything."""
    for name in kinds(cls):
        with pytest.raises(TypeError, match=f"{name} must be "):
            cls(**{name: object()})


@pytest.mark.parametrize("cls", CLASSES)
def test_every_number_has_a_range(cls):
    bare = [name for name, kind in kinds(cls).items() if kind in (int, float)]
    assert not bare


@pytest.mark.parametrize("cls", CLASSES)
def test_every_default_has_a_source(cls):
    described = re.split(r"^(\w+) : ", inspect.cleandoc(cls.__doc__), flags=re.MULTILINE)[1:]
    texts = dict(zip(described[::2], described[1::2], strict=True))
    for field in fields(cls):
        if not isinstance(getattr(cls(), field.name), Settings):
            source = re.search(r"(Chosen|Measured|Default|The standard's)\b.*", texts[field.name])
            assert source, f"{cls.__name__}.{field.name} does not say where its default comes from"


def test_every_setting_is_used():
    """None is left of a step that reads it no more."""
    package = Path(config.__file__).parents[1]
    used = {
        node.attr
        for path in package.rglob("*.py")
        if path.parent.name != "config"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
    } | {"log_chance_limit"}
    used |= {
        node.attr
        for node in ast.walk(ast.parse(Path(config.__file__).with_name("decode.py").read_text("utf-8")))
        if isinstance(node, ast.Attribute)
    }
    unused = {f"{cls.__name__}.{name}" for cls in CLASSES for name in kinds(cls) if name not in used}
    assert not unused
