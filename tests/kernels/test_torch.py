"""Differentiable PyTorch functions: in place, with the gradients that autograd finds for the definitions."""

import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import evqr_kernels.torch  # noqa: E402
from evqr_kernels.interop import warp_view  # noqa: E402
from evqr_kernels.warp_backend import replay  # noqa: E402
from evqr_kernels.warp_backend.rebinding import Rebindable  # noqa: E402

from . import cases  # noqa: E402
from .framework_cases import (  # noqa: E402
    BAD_CALLS,
    CASES,
    NOT_DIFFERENTIABLE,
    SHAPE,
    assert_like,
    bad_arguments,
    deposit_events,
    render_code,
    splat_events,
)

INDICES = ("window_ptr", "deposit_idx", "image_idx", "active")


@pytest.fixture(autouse=True)
def memory_without_a_value_is_nan(monkeypatch):
    """It is not 0 by luck."""
    empty = evqr_kernels.torch._empty

    def marked(*given, **more):
        made = empty(*given, **more)
        return made.fill_(torch.nan if made.is_floating_point() else -1)

    monkeypatch.setattr(evqr_kernels.torch, "_empty", marked)


@pytest.fixture(params=["cpu", *(f"cuda:{k}" for k in range(torch.cuda.device_count()))])
def device(request):
    wanted = request.config.getoption("device")
    if wanted and request.param not in wanted:
        pytest.skip("--device names others")
    return request.param


def tensors(case, device):
    made = {name: torch.from_numpy(array.copy()).to(device) for name, array in case.arrays.items()}
    for name in case.varied:
        made[name].requires_grad_()
    return made


@pytest.mark.parametrize("make", CASES, ids=lambda make: make.__name__)
def test_output_and_gradients_are_those_of_the_definition(make, device, dtype, rng):
    case = make(rng, dtype)
    given, plain = tensors(case, device), tensors(case, device)
    out = getattr(evqr_kernels.torch, case.op)(**given, **case.options)
    definition = {n: case.arrays[n] if n in INDICES else tensor for n, tensor in plain.items()}
    options = {**case.options, **({"erf": torch.erf} if case.uses_erf else {})}
    options |= {n: torch.from_numpy(array).to(device) for n, array in case.reference_options.items()}
    expected = case.reference(torch, **definition, **options)
    assert_like(out.detach().cpu(), expected.detach().cpu(), dtype)

    adj = torch.from_numpy(rng.normal(size=out.shape).astype(dtype)).to(device)
    out.backward(adj)
    expected.backward(adj)
    for name in case.varied:
        assert_like(given[name].grad.cpu(), plain[name].grad.cpu(), dtype)


@pytest.mark.parametrize("make", NOT_DIFFERENTIABLE, ids=lambda make: make.__name__)
def test_what_has_no_gradient_is_that_of_the_checked_function(make, device, dtype, rng):
    call = make(rng, dtype)
    given = {
        name: torch.from_numpy(value.copy()).to(device) if isinstance(value, np.ndarray) else value
        for name, value in call.checked.items()
    }
    function = getattr(evqr_kernels.torch, call.op)
    expected = getattr(evqr_kernels, call.op)(**call.checked)
    got = function(**given)
    assert got.device == given["x"].device
    np.testing.assert_allclose(got.cpu(), expected, rtol=1e-6)
    given["weight"].requires_grad_()
    with pytest.raises(ValueError, match=f"weight must not require a gradient: {call.op} has none"):
        function(**given)


def test_backward_through_a_sum(device, rng):
    """Its gradient is one number seen many times over, not contiguous."""
    case = splat_events(rng, np.float64)
    given = tensors(case, device)
    evqr_kernels.torch.splat_events(**given, **case.options).sum().backward()
    again = tensors(case, device)
    out = evqr_kernels.torch.splat_events(**again, **case.options)
    out.backward(torch.ones_like(out))
    torch.testing.assert_close(given["weight"].grad, again["weight"].grad, rtol=0, atol=0)


def test_gradcheck(device, rng):
    case = render_code(rng, np.float64, parameters=8, sigma=0.3)
    given = tensors(case, device)

    def render(grid, to_grid):
        return evqr_kernels.torch.render_code(grid, to_grid, given["outside"], shape=(6, 7), sigma=0.3)

    assert torch.autograd.gradcheck(render, (given["grid"], given["to_grid"]))


def test_no_copy_is_made(monkeypatch, rng):
    """The kernels get the memory of the tensors."""
    case = splat_events(rng, np.float32)
    given = tensors(case, "cpu")
    addresses = set()
    launch = Rebindable.__call__
    monkeypatch.setattr(
        Rebindable, "__call__", lambda self, at: (addresses.update(at), launch(self, at)) and None
    )
    out = evqr_kernels.torch.splat_events(**given, **case.options)
    assert {given[name].data_ptr() for name in ("x", "weight", "motion")} <= addresses
    assert out.data_ptr() in addresses


def test_calls_of_one_plan_from_several_threads(rng):
    """Each has a sequence of its own, with addresses of its own."""
    case = splat_events(rng, np.float32)
    batches = [tensors(splat_events(np.random.default_rng(k), np.float32), "cpu") for k in range(4)]
    expected = [evqr_kernels.torch.splat_events(**given, **case.options) for given in batches]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(20):
            got = pool.map(lambda given: evqr_kernels.torch.splat_events(**given, **case.options), batches)
            assert all(torch.equal(a, b) for a, b in zip(got, expected, strict=True))


def test_where_the_entries_of_kernels_are_not_known(monkeypatch, rng):
    """Launches are then made one by one, as on a GPU, at the same addresses."""
    case = splat_events(rng, np.float32, 6)
    expected, got = tensors(case, "cpu"), tensors(case, "cpu")
    out = evqr_kernels.torch.splat_events(**expected, **case.options)
    out.square().sum().backward()
    evqr_kernels.torch._plan.cache_clear()
    monkeypatch.setattr(replay, "ENTRIES_OF", ())
    again = [evqr_kernels.torch.splat_events(**got, **case.options) for _ in range(2)]
    for image in again:
        image.square().sum().backward()
    evqr_kernels.torch._plan.cache_clear()
    assert all(torch.equal(out, image) for image in again)
    for name in case.varied:
        torch.testing.assert_close(got[name].grad, 2 * expected[name].grad)


def image_of_motion(rng, dtype=np.float64):
    case = splat_events(rng, dtype)
    given = tensors(case, "cpu")
    given["weight"].requires_grad_(False)
    for name in ("x", "y"):
        given[name].requires_grad_(False)
    motion = given.pop("motion").detach()
    return (lambda m: evqr_kernels.torch.splat_events(motion=m, **given, **case.options)), motion


def test_functions_of_torch_func(rng):
    """Gradients, Jacobians and batches, one inside the other, are those of calls one after the other."""
    image, motion = image_of_motion(rng)

    def sharpness(m):
        return image(m).square().sum()

    by_hand = motion.clone().requires_grad_()
    sharpness(by_hand).backward()
    torch.testing.assert_close(torch.func.grad(sharpness)(motion), by_hand.grad)
    jacobian = torch.func.jacrev(image)(motion)
    adj = torch.randn(jacobian.shape[:3], dtype=torch.float64)
    _, pull = torch.func.vjp(image, motion)
    torch.testing.assert_close(torch.einsum("byx,byxcp->cp", adj, jacobian), pull(adj)[0])
    several = motion + torch.randn(3, *motion.shape, dtype=torch.float64)
    one_by_one = torch.stack([image(m) for m in several])
    assert torch.equal(torch.func.vmap(image)(several), one_by_one)
    assert torch.equal(torch.func.vmap(image, in_dims=2)(several.movedim(0, 2)), one_by_one)
    gradients = torch.stack([torch.func.grad(sharpness)(m) for m in several])
    torch.testing.assert_close(torch.func.vmap(torch.func.grad(sharpness))(several), gradients)
    total = torch.func.grad(lambda all_: torch.func.vmap(sharpness)(all_).sum())
    torch.testing.assert_close(total(several), gradients)


def test_a_batch_of_what_has_no_gradient(rng):
    call = cases.event_histogram(rng, np.float32)
    given = {
        n: torch.from_numpy(v.copy()) if isinstance(v, np.ndarray) else v for n, v in call.checked.items()
    }
    x = given.pop("x")
    several = torch.stack([x, x + 1])
    got = torch.func.vmap(lambda column: evqr_kernels.torch.event_histogram(column, **given))(several)
    assert torch.equal(got[1], evqr_kernels.torch.event_histogram(x + 1, **given))


def test_a_second_backward_pass_is_refused(rng):
    image, motion = image_of_motion(rng)
    motion.requires_grad_()
    (gradient,) = torch.autograd.grad(image(motion).square().sum(), motion, create_graph=True)
    with pytest.raises(RuntimeError, match="splat_events_adjoint has no adjoint of its own"):
        gradient.sum().backward()


def test_it_is_compiled_whole(rng):
    """One graph, forward and backward, whatever is not given; shapes may change."""
    torch._dynamo.reset()
    for make in (splat_events, deposit_events):
        case = make(rng, np.float32)

        def loss(given, case=case):
            return getattr(evqr_kernels.torch, case.op)(**given, **case.options).square().sum()

        compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
        for given in (case.arrays, case.arrays | {"weight": 2 * case.arrays["weight"]}):
            plain, ours = (
                {name: torch.from_numpy(array.copy()) for name, array in given.items()} for _ in range(2)
            )
            for name in case.varied:
                plain[name].requires_grad_()
                ours[name].requires_grad_()
            loss(plain).backward()
            compiled(ours).backward()
            for name in case.varied:
                torch.testing.assert_close(ours[name].grad, plain[name].grad)


def test_operators_are_what_they_say(rng):
    """By PyTorch's own check: schema, shapes without values, and traced with shapes that change."""
    case = deposit_events(rng, np.float32)
    given = tensors(case, "cpu")
    names = [a.name for a in evqr_kernels.OPERATIONS["deposit_events"].inputs]
    arguments = [given[n].detach() if n in given else None for n in names]
    operator = torch.ops.evqr_kernels.deposit_events.default
    torch.library.opcheck(operator, (*arguments, *SHAPE))
    adj = operator(*arguments, *SHAPE)
    torch.library.opcheck(torch.ops.evqr_kernels.deposit_events_adjoint.default, (adj, *arguments, *SHAPE))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"motion": lambda m: m[:, :1]}, ValueError, "motion must be contiguous, it is not copied"),
        ({"motion": lambda m: m.new_zeros(3, 5)}, ValueError, r"motion must have shape \(B, 2\) or \(B, 6\)"),
        ({"motion": lambda m: m.new_zeros(2, 2)}, ValueError, "motion must have shape .* with B = 3"),
        ({"weight": lambda w: w.double()}, TypeError, "weight must be float32 like the arrays before it"),
        (
            {"weight": lambda w: w.half()},
            TypeError,
            "weight must be .* or int32, got torch.float16",
        ),
        ({"window_ptr": lambda p: p.float()}, TypeError, "window_ptr must be int32, got float32"),
        (
            {"t": lambda t: t.requires_grad_()},
            ValueError,
            "t must not require a gradient: splat_events has one in weight, motion, x, y",
        ),
        ({"x": lambda x: x.numpy()}, TypeError, "x must be a torch.Tensor, got ndarray"),
    ],
)
def test_bad_arguments(change, error, message, rng):
    case = splat_events(rng, np.float32)
    given = {name: torch.from_numpy(array) for name, array in case.arrays.items()}
    for name, make in change.items():
        given[name] = make(given[name])
    with pytest.raises(error, match=message):
        evqr_kernels.torch.splat_events(**given, **case.options)


@pytest.mark.parametrize(("op", "changes", "error", "message"), BAD_CALLS)
def test_what_the_checked_functions_refuse(op, changes, error, message):
    arrays, options = bad_arguments(op, changes, torch.from_numpy)
    message = message.replace("a NumPy array", "a torch.Tensor").replace("result", op)
    with pytest.raises(error, match=re.escape(message)):
        getattr(evqr_kernels.torch, op)(*arrays, **options)


def test_checked_functions_take_tensors(rng):
    case = splat_events(rng, np.float32)
    given = {name: torch.from_numpy(array) for name, array in case.arrays.items()}
    image = evqr_kernels.splat_events(**given, **case.options)
    np.testing.assert_array_equal(image, evqr_kernels.splat_events(**case.arrays, **case.options))
    given["weight"].requires_grad_()
    with pytest.raises(TypeError, match="weight cannot be read without a copy"):
        evqr_kernels.splat_events(**given, **case.options)


@pytest.mark.parametrize("dtype", [torch.int64, torch.float16, torch.bool, torch.complex64])
def test_no_view_of_another_dtype(dtype):
    with pytest.raises(TypeError, match=r"array (must be float32, float64, int32|cannot be read)"):
        warp_view(torch.zeros(3, dtype=dtype))


def test_no_view_of_what_takes_part_in_differentiation():
    with pytest.raises(TypeError, match=r"array cannot be read without a copy: .*gradient"):
        warp_view(torch.zeros(3, requires_grad=True))
