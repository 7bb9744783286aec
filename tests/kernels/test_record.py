"""Recorded sequences of operations: noted down without running, then run as often as they are called."""

from concurrent.futures import ThreadPoolExecutor
from threading import Thread

import numpy as np
import pytest

from evqr_kernels import get_backend

ONE = np.ones(3, np.float32)
PTR = np.array([0, 3], np.int32)


def counting(backend, device):
    """An image of counts, and a function that counts three events into it and mixes it twofold."""
    image, mixed = (backend.from_host(np.zeros((1, 4, 16), np.float32), device) for _ in range(2))
    x, weight = backend.from_host(ONE, device), backend.from_host(ONE, device)
    ptr, first = backend.from_host(PTR, device), backend.from_host(np.zeros(1, np.int32), device)
    twice = backend.from_host(np.full((1, 1), 2.0, np.float32), device)

    images = image.reshape((1, 1, 4, 16))

    def run():
        backend.bin_events(x, x, weight, ptr, 1.0, image)
        backend.mix_images(images, first, twice, mixed)

    return image, mixed, run


def value(backend, image, device):
    backend.synchronize(device)
    return float(backend.to_host(image)[0, 1, 1])


def test_a_sequence_runs_when_it_is_called(placed):
    backend, device = placed.backend, placed.device
    image, mixed, run = counting(backend, device)
    recorded = backend.record(run)
    assert value(backend, image, device) == 0.0
    for times in (1, 2, 3):
        recorded()
        assert value(backend, image, device) == 3.0 * times
        assert value(backend, mixed, device) == 6.0 * times
    run()
    assert value(backend, image, device) == 12.0


def test_arrays_that_are_parts_of_a_block(placed):
    """Written and read as one block, of several dtypes and shapes; parts of parts are parts."""
    backend, device = placed.backend, placed.device
    words = np.zeros(64, np.uint32)
    words[:3], words[16:18], words[20:22] = ONE.view(np.uint32), PTR.view(np.uint32), (7, 9)
    block = backend.from_host(np.zeros(64, np.uint32), device)
    backend.assign(block, words)
    x, weight = (backend.part(block, 0, (3,), np.float32) for _ in range(2))
    ptr = backend.part(block, 16, (2,), np.int32)
    images = backend.part(block, 32, (2, 1, 2, 8), np.float32)
    image = images[1:].reshape((1, 2, 8))
    run = backend.record(lambda: backend.bin_events(x, x, weight, ptr, 1.0, image))
    run()
    run()
    backend.synchronize(device)
    there = np.array(backend.to_host(block))
    np.testing.assert_array_equal(there[:48], [*words[:32], *[0] * 16])
    assert there[48:].view(np.float32).reshape(2, 8)[1, 1] == 6.0 == there[48:].view(np.float32).sum()
    narrow = backend.part(block, 20, (3,), np.uint16)
    np.testing.assert_array_equal(np.array(backend.to_host(narrow)), [7, 0, 9])
    backend.assign(backend.part(block, 16, (32,), np.uint32), np.arange(32, dtype=np.uint32))
    np.testing.assert_array_equal(np.array(backend.to_host(ptr)), [0, 1])


def test_clearing_is_recorded_too(placed):
    backend, device = placed.backend, placed.device
    image, _, run = counting(backend, device)

    def from_zero():
        backend.clear(image)
        run()

    recorded = backend.record(from_zero)
    run()
    assert value(backend, image, device) == 3.0
    recorded()
    recorded()
    assert value(backend, image, device) == 3.0


def test_threads_record_and_replay_each_its_own(placed):
    backend, device = placed.backend, placed.device

    def work(times):
        image, _, run = counting(backend, device)
        recorded = backend.record(run)
        for _ in range(times):
            recorded()
        return value(backend, image, device)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(work, range(1, 21))) == [3.0 * times for times in range(1, 21)]


def test_what_is_cleared_need_not_be_in_one_piece(placed):
    backend, device = placed.backend, placed.device
    ones = backend.from_host(np.ones((1, 4, 16), np.float32), device)
    recorded = backend.record(lambda: backend.clear(ones[:, 1:3, 4:8]))
    recorded()
    backend.synchronize(device)
    expected = np.ones((1, 4, 16))
    expected[:, 1:3, 4:8] = 0.0
    np.testing.assert_array_equal(backend.to_host(ones), expected)


def test_on_the_cpu_a_sequence_is_one_call(monkeypatch):
    import warp as wp

    from evqr_kernels.warp_backend import replay

    if not wp.config.version.startswith(replay.ENTRIES_OF):
        pytest.skip(f"it is not known whether an entry of Warp {wp.config.version} takes two pointers")
    backend, launch, counts = get_backend("warp"), wp.Launch.launch, []
    monkeypatch.setattr(wp.Launch, "launch", lambda self: (counts.append(counts.pop() + 1), launch(self)))
    for versions in (replay.ENTRIES_OF, ("no version",)):
        monkeypatch.setattr(replay, "ENTRIES_OF", versions)
        counts.append(0)
        image, _, run = counting(backend, "cpu")
        backend.record(run)()
        assert value(backend, image, "cpu") == 3.0
    assert counts == [0, 2]


def test_a_turn_that_is_never_given_back_is_taken(monkeypatch):
    """A step that does what another thread would: the sequence waits for it, and not for ever."""
    import warp as wp

    from evqr_kernels.warp_backend import language, replay

    if not wp.config.version.startswith(replay.ENTRIES_OF):
        pytest.skip(f"it is not known whether an entry of Warp {wp.config.version} takes two pointers")
    monkeypatch.setattr(replay, "MOST_LOOKS", 1000)
    turn = wp.array(ptr=replay._TURN.ctypes.data, dtype=wp.int32, shape=1, device="cpu")

    @wp.kernel
    def take(turn_out: wp.array(dtype=wp.int32)):
        turn_out[0] = 1

    sequence = language.record(
        lambda: language.launch(take, 1, inputs=[], outputs=[turn], device=turn.device)
    )
    thread = Thread(target=sequence, daemon=True)
    thread.start()
    thread.join(timeout=5.0)
    assert not thread.is_alive()
    backend = get_backend("warp")
    image, _, run = counting(backend, "cpu")
    backend.record(run)()
    assert value(backend, image, "cpu") == 3.0


def test_an_error_ends_the_recording(placed):
    backend, device = placed.backend, placed.device
    image, _, run = counting(backend, device)

    def broken():
        run()
        raise KeyError("no such thing")

    with pytest.raises(KeyError):
        backend.record(broken)
    before = value(backend, image, device)
    run()
    assert value(backend, image, device) == before + 3.0


def test_a_recorded_sequence_can_be_captured_in_a_graph():
    """As CUDA graphs are, and on the CPU too."""
    import warp as wp

    backend = get_backend("warp")
    device = backend.devices()[-1]
    image, mixed, run = counting(backend, device)
    recorded = backend.record(run)
    recorded()  # modules are loaded
    with wp.ScopedCapture(device=device) as capture:
        recorded()
    assert value(backend, image, device) == 3.0
    for _ in range(4):
        wp.capture_launch(capture.graph)
    assert value(backend, image, device) == 15.0
    assert value(backend, mixed, device) == 30.0


@pytest.fixture
def graph_of():
    """What a recorded sequence is on a GPU, on the CPU, which captures graphs of launches one by one, too."""
    import warp as wp

    from evqr_kernels.warp_backend.graph import Graph
    from evqr_kernels.warp_backend.language import recorded

    def make(run):
        steps = recorded(run)
        calls = [step.launch if isinstance(step, wp.Launch) else step.zero_ for step in steps]
        return Graph(calls, wp.get_device("cpu"))

    return make


def test_on_a_gpu_a_sequence_becomes_a_graph(graph_of, monkeypatch):
    """Captured once, when it is made the second time."""
    import warp as wp

    backend, launches, graph_launch = get_backend("warp"), [], wp.capture_launch
    monkeypatch.setattr(wp, "capture_launch", lambda graph: (launches.append(graph), graph_launch(graph)))
    image, mixed, run = counting(backend, "cpu")
    graph = graph_of(run)
    for times in (1, 2, 3, 4):
        graph()
        assert value(backend, image, "cpu") == 3.0 * times
        assert value(backend, mixed, "cpu") == 6.0 * times
    assert len(launches) == 3 and len({id(each) for each in launches}) == 1


def test_a_graph_can_be_a_part_of_another(graph_of):
    import warp as wp

    backend = get_backend("warp")
    image, _, run = counting(backend, "cpu")
    graph = graph_of(run)
    graph()
    with wp.ScopedCapture(device="cpu") as capture:
        graph()
    assert value(backend, image, "cpu") == 3.0
    wp.capture_launch(capture.graph)
    graph()
    assert value(backend, image, "cpu") == 9.0


def test_where_no_graph_is_captured_steps_are_made_one_by_one(graph_of, monkeypatch, caplog):
    import warp as wp

    class Refusing(wp.ScopedCapture):
        def __exit__(self, *args):
            super().__exit__(*args)
            raise RuntimeError("memory was allocated")

    backend = get_backend("warp")
    image, _, run = counting(backend, "cpu")
    graph = graph_of(run)
    monkeypatch.setattr(wp, "ScopedCapture", Refusing)
    for times in (1, 2, 3):
        graph()
        assert value(backend, image, "cpu") == 3.0 * times
    assert [record.getMessage() for record in caplog.records] == [
        "cpu captures no graph, kernels are launched one by one: memory was allocated"
    ]
