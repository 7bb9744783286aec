"""The picture of a reading: what each panel shows."""

from __future__ import annotations

import dataclasses
import re
import sys
import warnings

import numpy as np
import pytest
import sample_results

from evqr.errors import MissingExtra, UsageError
from evqr.events.array import EventArray
from evqr_kernels.extras import install_command

pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")

from evqr.output import picture
from evqr.output.overview import draw_recording
from evqr.output.span import Timeline
from evqr.recording import summarise
from evqr.seen import Candidate, Nearest


def moving_dots(reading):
    """Events of two dots that travel with the code: at ``t_read_us`` ON at (60, 60), OFF at (100, 90)."""
    t = np.arange(reading.t_first_us, reading.t_read_us, 10, dtype=np.int64)
    age_s = (t - reading.t_read_us) * 1e-6
    vx, vy = reading.motion_px_per_s
    t, age_s = np.repeat(t, 2), np.repeat(age_s, 2)
    second = np.arange(len(t)) % 2 == 1
    return EventArray(
        t,
        np.round(np.where(second, 100, 60) + vx * age_s).astype(np.uint16),
        np.round(np.where(second, 90, 60) + vy * age_s).astype(np.uint16),
        np.where(second, -1, 1).astype(np.int8),
        160,
        120,
    )


def test_span_ends_when_the_code_is_read_or_covers_the_same_travel_later():
    late = picture.span_us(sample_results.reading(t_first_us=0, t_read_us=9000))
    early = picture.span_us(sample_results.reading(t_first_us=8900, t_read_us=9000))
    assert late[1] == 9000
    assert early[0] == 8900
    # Three modules of 4 px at 4031 px/s.
    assert late[1] - late[0] == early[1] - early[0] == round(3 * 4 / 4031.13 * 1e6)


def panels(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes}


def panel(figure, start):
    (axes,) = (axes for title, axes in panels(figure).items() if title.startswith(start))
    return axes


def legend_of(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_wrong_modules_are_coloured():
    estimate = sample_results.READING.estimate.copy()
    (false_light, *_), (false_dark, second_false_dark, *_) = (
        list(zip(*np.nonzero(sample_results.MODULES == sign), strict=True)) for sign in (-1, 1)
    )
    estimate[false_light] *= -1
    estimate[false_dark] *= -1
    estimate[second_false_dark] *= -1
    figure = picture.draw_reading(sample_results.events(), sample_results.reading(estimate=estimate))
    axes = panel(figure, "their signs")
    assert axes.get_title(loc="left") == "their signs: 3 of 441 other than decoded"
    assert legend_of(axes) == ["dark, decoded as light", "light, decoded as dark"]
    (image,) = axes.images
    colours = image.cmap(image.norm(image.get_array()))
    magenta, green = np.array([0.9, 0.0, 0.62]), np.array([0.18, 0.7, 0.27])
    np.testing.assert_allclose(colours[false_dark][:3], magenta, atol=0.01)
    np.testing.assert_allclose(colours[second_false_dark][:3], magenta, atol=0.01)
    np.testing.assert_allclose(colours[false_light][:3], green, atol=0.01)
    others = np.ones_like(estimate, bool)
    others[false_light] = others[false_dark] = others[second_false_dark] = False
    brightness = colours[..., :3].mean(axis=-1)
    np.testing.assert_array_equal(brightness[others] > 0.5, sample_results.MODULES[others] > 0)


def test_truth_takes_the_place_of_what_was_decoded():
    truth = -sample_results.MODULES
    figure = picture.draw_reading(sample_results.events(), sample_results.READING, truth=truth)
    assert panel(figure, "their signs").get_title(loc="left") == "their signs: 441 of 441 wrong"
    (image,) = panel(figure, "modules, true").images
    np.testing.assert_array_equal(np.asarray(image.get_array()) == 0, truth < 0)
    assert "modules, as decoded" not in panels(figure)
    assert legend_of(panel(figure, "their signs")) == ["dark, truly light", "light, truly dark"]


def test_truth_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"truth must have shape \(21, 21\), got \(25, 25\)"):
        picture.draw_reading(
            sample_results.events(), sample_results.READING, truth=np.ones((25, 25), np.int8)
        )


def test_motion_is_taken_out():
    reading = sample_results.READING
    figure = picture.draw_reading(moving_dots(reading), reading)
    (image,) = panel(figure, "motion taken out").images
    values, (x0, x1, y1, y0) = np.asarray(image.get_array()), image.get_extent()

    def where(index):
        row, column = np.unravel_index(index, values.shape)
        return x0 + (column + 0.5) * (x1 - x0) / values.shape[1], y0 + (row + 0.5) * (y1 - y0) / values.shape[
            0
        ]

    np.testing.assert_allclose(where(values.argmax()), (60, 60), atol=0.8)
    np.testing.assert_allclose(where(values.argmin()), (100, 90), atol=0.8)
    spread = (np.abs(values) > 0.05 * np.abs(values).max()).sum()
    assert spread < 120  # two dots, not two streaks: in 3.1 ms the code moves 12 px


def test_outline_is_where_it_was_found():
    figure = picture.draw_reading(sample_results.events(), sample_results.READING)
    for title in ("events of", "motion taken out"):
        (outline,) = panel(figure, title).patches
        np.testing.assert_array_equal(outline.get_xy()[:4], sample_results.READING.corners_px)


def test_an_outline_that_leaves_the_sensor_leaves_the_layout_as_it_is():
    corners = np.array([[-300.0, -200.0], [84.0, -200.0], [84.0, 184.0], [-300.0, 184.0]])
    inside = picture.draw_reading(sample_results.events(), sample_results.READING)
    outside = picture.draw_reading(sample_results.events(), sample_results.reading(corners_px=corners))
    for one, other in zip(inside.axes, outside.axes, strict=True):
        for figure in (inside, outside):
            figure.canvas.draw()
        np.testing.assert_allclose(one.get_position().bounds, other.get_position().bounds, atol=1e-6)
    axes = panel(outside, "events of")
    assert (axes.get_xlim(), axes.get_ylim()) == ((-0.5, 159.5), (119.5, -0.5))


@pytest.fixture(scope="module")
def nothing():
    velocity = np.array([4000.0, -500.0])
    candidate = Candidate(symbol="QRCode 1", score=0.7654, corners_px=sample_results.READING.corners_px)
    return dataclasses.replace(
        sample_results.no_read_result(),
        nearest=Nearest(t_us=9000, motion_px_per_s=velocity, candidates=(candidate,)),
    )


def test_nothing_read_shows_the_best_candidates_with_the_motion_taken_out(nothing):
    reading = sample_results.READING
    figure = picture.draw_reading(moving_dots(dataclasses.replace(reading, t_read_us=12000)), nothing)
    assert any("nothing read: no finder pattern was seen" in text.get_text() for text in figure.texts)
    axes = panel(figure, "motion taken out")
    (outline,) = axes.patches
    np.testing.assert_array_equal(outline.get_xy()[:4], reading.corners_px)
    assert "QRCode 1? 0.77" in [text.get_text() for text in axes.texts]
    values = np.abs(np.asarray(axes.images[0].get_array()))
    assert (values > 0.05 * values.max()).sum() < 150  # two dots, not two streaks
    assert any(title.startswith("events a millisecond") for title in panels(figure))


def test_nothing_read_of_any_kind_can_be_drawn(tmp_path, nothing):
    still = sample_results.no_read_result()
    none_taken = dataclasses.replace(nothing, nearest=dataclasses.replace(nothing.nearest, candidates=()))
    for result in (still, none_taken):
        path = tmp_path / "nothing.png"
        picture.save_picture(path, sample_results.events(), result)
        assert path.stat().st_size > 10_000


def test_results_draw_themselves_from_whatever_holds_the_events(tmp_path, nothing):
    path = sample_results.recording(tmp_path / "events.h5")
    result = dataclasses.replace(sample_results.read_result(), source=str(path))
    events = sample_results.events()
    figures = [
        result.draw(),
        result.draw(events),
        result.draw(path, reading=-1),
        result.readings[0].draw(path, truth=sample_results.MODULES),
        picture.draw_reading(path, result),
        picture.draw_reading(
            (events.t, events.x, events.y, events.p), result, sensor="160x120", time_unit="us"
        ),
    ]
    images = [np.asarray(panel(figure, "events of").images[0].get_array()) for figure in figures]
    for image in images:
        np.testing.assert_array_equal(image, images[0])
    assert panels(dataclasses.replace(nothing, source=str(path)).draw())
    with pytest.raises(ValueError, match="reading must be one of 1, got 1"):
        result.draw(reading=1)
    with pytest.raises(ValueError, match="source must be given"):
        sample_results.read_result().draw()
    with pytest.raises(TypeError, match="reading must be a CodeReading or a ReadResult, got str"):
        picture.draw_reading(path, "LOT 42")  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match="and the source one: the source comes first"):
        picture.draw_reading(result, path)  # pyright: ignore[reportArgumentType]


def test_who_names_a_picture_gets_it(tmp_path, nothing):
    path = sample_results.recording(tmp_path / "events.h5")
    read, none = (
        dataclasses.replace(result, source=str(path)) for result in (sample_results.read_result(), nothing)
    )
    pictures = [tmp_path / f"{name}.png" for name in "abcdef"]
    read.draw(pictures[0])
    read.draw(str(pictures[1]), reading=-1)
    read.draw(sample_results.events(), pictures[2])
    none.draw(to=pictures[3])
    read.readings[0].draw(path, to=pictures[4])
    picture.draw_reading(path, read, to=pictures[5])
    assert [each.exists() for each in pictures] == [True] * 6
    with pytest.raises(
        TypeError, match=r"source must be given, what holds the events: draw\(source, to='x.png'\)"
    ):
        read.readings[0].draw("x.png")
    with pytest.raises(UsageError, match=r"x.bmp: unknown picture format 'bmp'"):
        read.draw("x.bmp")
    with pytest.raises(TypeError, match="got int"):
        read.draw(3)


def test_what_a_camera_saw(tmp_path):
    path = sample_results.recording(tmp_path / "events.h5")
    figure = draw_recording(path, summarise(path))
    (counts,) = panel(figure, "events a pixel").images
    assert np.expm1(np.asarray(counts.get_array())).sum() == pytest.approx(4000)
    assert any("160x120" in text.get_text() for text in figure.texts)


def test_a_timeline_counts_all_events_however_long_it_gets():
    timeline, events = Timeline(), sample_results.events()
    for start in range(0, 4000, 500):
        timeline.add(events.cut(start, start + 500))
    assert timeline.per_ms.sum() * timeline.bin_us / 1000 == pytest.approx(4000)
    assert timeline.bin_us * len(timeline.per_ms) >= events.t[-1] - events.t[0]


def test_events_panel_shows_the_last_event_of_each_pixel():
    t_read = sample_results.READING.t_read_us
    events = EventArray(
        np.array([t_read - 20, t_read - 10, t_read, t_read + 5]),
        np.array([7, 7, 9, 9], np.uint16),
        np.array([5, 5, 5, 5], np.uint16),
        np.array([1, -1, 1, 1], np.int8),
        160,
        120,
    )
    (image,) = panel(picture.draw_reading(events, sample_results.READING), "events of").images
    values = np.asarray(image.get_array())
    assert values[5, 7] == -1
    assert np.count_nonzero(values) == 1  # what came after the span is not shown


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_files(tmp_path, ending):
    path = tmp_path / f"reading.{ending}"
    picture.save_picture(path, sample_results.events(), sample_results.READING)
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize(
    "text", ["$x^2$ \\alpha {", "\N{CJK UNIFIED IDEOGRAPH-6F22}\u5b57", "", "long " * 500, "\x1b[2J"]
)
def test_any_text_can_be_drawn(tmp_path, text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        path = tmp_path / "reading.png"
        picture.save_picture(path, sample_results.events(), sample_results.reading(text=text))


def test_degenerate_readings_can_be_drawn():
    nothing = sample_results.events(1).cut(0, 0)
    still = sample_results.reading(motion_px_per_s=np.zeros(2), estimate=np.zeros((21, 21), np.float32))
    assert len(picture.draw_reading(nothing, still).axes) == 5


def test_bad_places_are_one_line(tmp_path):
    events, reading = sample_results.events(), sample_results.READING
    with pytest.raises(UsageError, match=r"reading.doc: unknown picture format 'doc'"):
        picture.save_picture(tmp_path / "reading.doc", events, reading)
    with pytest.raises(UsageError, match=r"reading.png: cannot write the picture: no such folder"):
        picture.save_picture(tmp_path / "nowhere" / "reading.png", events, reading)


def test_missing_matplotlib_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtra, match=re.escape(install_command("plot"))):
        picture.draw_reading(sample_results.events(), sample_results.READING)


def test_events_of_the_picture_come_from_any_chunks(tmp_path):
    from evqr.recording import open_recording

    path = sample_results.recording(tmp_path / "events.h5")
    start, end = picture.span_us(sample_results.READING)
    wanted = sample_results.events().between(start, end)
    for chunk_events in (100, 1 << 20):
        with open_recording(path, chunk_events=chunk_events) as recording:
            got = picture.picture_events(recording, sample_results.READING)
        for name in "txyp":
            np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name))


def test_a_symbol_that_is_no_square_can_be_drawn():
    modules = np.where(np.random.default_rng(1).random((11, 27)) < 0.5, -1, 1).astype(np.int8)
    corners = np.array([[10.0, 10.0], [118.0, 10.0], [118.0, 54.0], [10.0, 54.0]])  # 4 px a module
    reading = sample_results.reading(
        symbology="RMQRCode", version="R11x27", mask=None, corners_px=corners, modules=modules,
        estimate=modules.astype(np.float32),
    )  # fmt: skip
    start, end = picture.span_us(reading)
    assert end - start == round(3 * 4 / 4031.13 * 1e6)
    figure = picture.draw_reading(moving_dots(reading), reading)
    assert any("RMQRCode R11x27-M" in text.get_text() for text in figure.texts)
    assert panel(figure, "modules, estimated").images[0].get_array().shape == (11, 27)
