"""The data set: what is in it, that it is made once, and a manifest written by hand."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from evqr.errors import RecordingError, UsageError
from evqr.paper.dataset import make
from evqr.paper.dataset.manifest import load_manifest, load_sequence
from evqr.paper.dataset.scenes import ANGLES, KINDS, TEXTS, scenes
from evqr.recording.writing import save_recording
from evqr.simulate import simulate


def tiny():
    """Two scenes that take no time to make."""
    kind = replace(KINDS[0], module_px=3.5)
    for spec in list(scenes(most_windows=14))[:2]:
        yield replace(spec, kind=kind)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    make.make_dataset(folder, tiny())
    return folder


def test_eighteen_scenes_with_the_paper_s_geometry():
    specs = list(scenes())
    assert len({spec.name for spec in specs}) == len({spec.seed for spec in specs}) == 18
    assert {(s.kind.name, s.angle, s.text) for s in specs} == {
        (kind.name, angle, text) for kind in KINDS for angle in ANGLES for text in TEXTS
    }
    travel = {kind.name: kind.speed_px_ms * kind.window_us / 1000 for kind in KINDS}
    assert travel == pytest.approx({"faster": 2.9, "slower": 1.02, "simulator": 1.25})


def test_scenes_of_other_texts_and_seeds():
    specs = list(scenes(texts=("ONE", "TWO", "THREE"), seed=50))
    assert [spec.seed for spec in specs] == list(range(50, 77))
    assert [spec.text for spec in specs[::9]] == ["ONE", "TWO", "THREE"]
    assert [spec.name for spec in specs[::9]] == ["faster-00-a", "faster-00-b", "faster-00-c"]
    with pytest.raises(UsageError, match="27 texts are too many"):
        list(scenes(texts=["X"] * 27))


def test_a_text_that_does_not_fit_is_told_before_anything_is_made(tmp_path):
    with pytest.raises(UsageError, match="does not fit version 2 at level H"):
        make.make_dataset(tmp_path / "new", scenes(texts=("FITS", "x" * 15), most_windows=14))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_code_stays_in_view(kind):
    widest = 25 * kind.module_px * np.sqrt(2.0)
    assert kind.windows * kind.window_us * kind.speed_px_ms / 1000 + widest < 640


def test_a_scene_has_events_truth_and_frames(folder):
    entry = load_manifest(folder)[0]
    sequence = load_sequence(folder, entry)
    assert (entry.name, entry.scene, entry.angle, entry.text) == ("faster-00-a", "faster", 0, TEXTS[0])
    assert sequence.windows == 14 and len(sequence.events) > 10_000
    assert sequence.frames.shape == (1, 480, 640) and sequence.frames.dtype == np.uint8
    assert sequence.truth.modules.shape == (25, 25)
    window = sequence.window(2, 3)
    assert (window.start_us, window.end_us) == (500, 1250)


def test_truth_of_the_manifest_is_truth_of_the_simulation(folder):
    import h5py

    entry = load_manifest(folder)[0]
    with h5py.File(folder / entry.recording) as file:
        dark = np.asarray(file["truth/modules"]) > 0
    np.testing.assert_array_equal(entry.truth().modules, np.where(dark, -1, 1))


def test_a_frame_is_blurred_along_the_motion_only(folder):
    frame = load_sequence(folder, load_manifest(folder)[0]).frames[0].astype(float)
    code = frame[200:280, 270:370]
    assert np.abs(np.diff(code, axis=0)).mean() > 3 * np.abs(np.diff(code, axis=1)).mean()


def test_checksums_are_of_the_files(folder):
    sums = dict(reversed(line.split("  ")) for line in (folder / make.SUMS).read_text().splitlines())
    assert len(sums) == 4
    for name, digest in sums.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


def test_card_names_every_parameter(folder):
    card = (folder / "README.md").read_text()
    for word in ("faster-00-a", "sensor.tau_us", "camera.exposure_us", "CC0", "seed"):
        assert word in card


def test_what_is_there_is_not_made_again_and_what_is_not_is(folder, monkeypatch):
    made = []
    real = make.simulate_scene
    monkeypatch.setattr(make, "simulate_scene", lambda *a, **k: (made.append(a), real(*a, **k))[1])
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    make.make_dataset(folder, tiny())
    assert not made
    (folder / "faster-30-a.h5").unlink()
    seen = []
    make.make_dataset(folder, tiny(), progress=seen.append)
    assert len(made) == 1 and seen == ["faster-00-a", "faster-30-a"]
    # made again it is the same, to the byte; so is one that was damaged
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    (folder / "faster-00-a.h5").write_bytes(before["faster-00-a.h5"][:1000])
    make.make_dataset(folder, tiny())
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_scene_of_other_parameters_is_made_again(folder, tmp_path):
    import shutil

    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    before = (tmp_path / "faster-00-a.h5").read_bytes()
    make.make_dataset(tmp_path, [replace(next(iter(tiny())), seed=99)])
    assert (tmp_path / "faster-00-a.h5").read_bytes() != before


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        make.make_dataset(tmp_path / "file" / "folder", tiny())


OWN = {
    "name": "belt-1", "scene": "belt", "angle": 20, "recording": "belt.npz", "text": "OWN",
    "version": 1, "level": "M", "window_us": 500,
}  # fmt: skip


def write_manifest(folder, **changes):
    scene = {name: value for name, value in {**OWN, **changes}.items() if value is not None}
    (folder / "manifest.json").write_text(json.dumps({"scenes": [scene]}))


def test_a_recording_of_one_s_own(tmp_path):
    made = simulate("OWN", version=1, angle=20.0, width=200, height=160, module_px=4.0, duration_us=3000)
    save_recording(tmp_path / "belt.npz", made.events)
    write_manifest(tmp_path, start_us=500)
    sequence = load_sequence(tmp_path, *load_manifest(tmp_path))
    assert sequence.windows == 5 and not len(sequence.frames)
    np.testing.assert_array_equal(sequence.truth.modules, np.where(made.truth["truth"]["modules"] > 0, -1, 1))


def test_modules_may_be_told(tmp_path):
    rows = ["01" * 10 + "0"] * 21
    write_manifest(tmp_path, modules=rows)
    truth = load_manifest(tmp_path)[0].truth()
    assert (truth.modules[:, 1::2] == -1).all() and (truth.modules[:, ::2] == 1).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"text": None}, "text"),
        ({"colour": "red"}, "unknown field 'colour'"),
        ({"version": 41}, "version must be 1 to 40"),
        ({"modules": ["01"]}, "21 rows of 21"),
    ],
    ids=["missing", "unknown", "version", "modules"],
)
def test_a_manifest_that_is_wrong_says_how(tmp_path, changes, message):
    write_manifest(tmp_path, **changes)
    with pytest.raises(UsageError, match=message):
        load_manifest(tmp_path)


def test_a_folder_without_a_manifest(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        load_manifest(tmp_path)
    (tmp_path / "manifest.json").write_text("[]")
    with pytest.raises(UsageError, match="is no manifest"):
        load_manifest(tmp_path)
