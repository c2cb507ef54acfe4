"""Code that names CUDA runs on the CPU."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs, on_cpu

CALLS: dict[str, Callable[[], Tensor]] = {
    "Tensor.cuda": lambda: torch.ones(2).cuda(),
    "Tensor.cuda with options": lambda: torch.ones(2).cuda(0, non_blocking=True),
    "Tensor.to with a name": lambda: torch.ones(2).to("cuda:0"),
    "Tensor.to with a device and a dtype": lambda: torch.ones(2).to(
        torch.device("cuda"), torch.float64
    ),
    "Tensor.pin_memory": lambda: torch.ones(2).pin_memory(),
    "Module.cuda": lambda: nn.Linear(2, 2).cuda().weight,
    "Module.to": lambda: nn.Linear(2, 2).to("cuda").weight,
    "a layer made on a device": lambda: nn.Linear(2, 2, device="cuda").weight,
    "zeros": lambda: torch.zeros(2, device="cuda"),
    "zeros in pinned memory": lambda: torch.zeros(2, pin_memory=True),
    "tensor": lambda: torch.tensor([1.0], device=torch.device("cuda", 0)),
    "as_tensor": lambda: torch.as_tensor([1.0], device="cuda"),
    "arange": lambda: torch.arange(3, device="cuda"),
    "zeros_like": lambda: torch.zeros_like(torch.ones(2), device="cuda"),
    "Tensor.type with a name": lambda: torch.ones(2).type("torch.cuda.DoubleTensor"),
    "Tensor.type with a type": lambda: torch.ones(2).type(torch.cuda.HalfTensor),
    "a type of tensors": lambda: torch.cuda.FloatTensor([1.0, 2.0]),
    "full": lambda: torch.full((2,), 1.0, device="cuda:1"),
    "eye": lambda: torch.eye(3, device="cuda"),
    "linspace": lambda: torch.linspace(0, 1, 3, device="cuda"),
    "meshgrid": lambda: torch.meshgrid(*[torch.arange(2, device="cuda")] * 2, indexing="ij")[0],
    "randn with a generator": lambda: torch.randn(
        2, device="cuda", generator=torch.Generator(device="cuda").manual_seed(1)
    ),
    "rand_like": lambda: torch.rand_like(torch.ones(2), device="cuda"),
    "empty": lambda: torch.empty(2, device="cuda"),
    "from_numpy": lambda: torch.from_numpy(np.ones(2)).to("cuda", non_blocking=True),
    "stack": lambda: torch.stack([torch.ones(2).cuda(), torch.zeros(2, device="cuda")]),
    "a default device": lambda: _of_default_device(),
    "a device's block": lambda: _in_a_block(torch.device("cuda")),
    "a device of torch.cuda": lambda: _in_a_block(torch.cuda.device(0)),
    "a stream": lambda: _in_a_block(torch.cuda.stream(torch.cuda.Stream())),
    "autocast of torch.cuda": lambda: _in_a_block(torch.cuda.amp.autocast()),
    "autocast": lambda: _in_a_block(torch.autocast("cuda", dtype=torch.float16)),
    "a tensor that a stream reads": lambda: _recorded(torch.ones(2)),
    "Module.half": lambda: nn.Linear(2, 2).cuda().half().weight,
    "Sequential.to": lambda: nn.Sequential(nn.Linear(2, 2)).to(torch.device("cuda:0"))[0].weight,
    "register_buffer": lambda: nn.BatchNorm1d(2, device="cuda").running_mean,
    "new_zeros": lambda: torch.ones(2).new_zeros(3, device="cuda"),
}


# Calls into the driver: what they return, or None for anything.
DRIVER_CALLS: dict[str, tuple[Callable[[], object], object]] = {
    "synchronize": (lambda: torch.cuda.synchronize(), None),
    "synchronize a device": (lambda: torch.cuda.synchronize(torch.device("cuda")), None),
    "set_device": (lambda: torch.cuda.set_device("cuda:0"), None),
    "empty_cache": (lambda: torch.cuda.empty_cache(), None),
    "manual_seed": (lambda: torch.cuda.manual_seed(0), None),
    "manual_seed_all": (lambda: torch.cuda.manual_seed_all(0), None),
    "reset_peak_memory_stats": (lambda: torch.cuda.reset_peak_memory_stats(), None),
    "set_stream": (lambda: torch.cuda.set_stream(torch.cuda.Stream()), None),
    "ipc_collect": (lambda: torch.cuda.ipc_collect(), None),
    "nvtx": (lambda: (torch.cuda.nvtx.range_push("a"), torch.cuda.nvtx.range_pop()), None),
    "memory_allocated": (lambda: torch.cuda.memory_allocated(), 0),
    "max_memory_allocated": (lambda: torch.cuda.max_memory_allocated("cuda"), 0),
    "memory_reserved": (lambda: torch.cuda.memory_reserved(0), 0),
    "current_device": (lambda: torch.cuda.current_device(), 0),
    "get_device_name": (lambda: torch.cuda.get_device_name(0), "cpu"),
    "get_device_capability": (lambda: torch.cuda.get_device_capability(), (0, 0)),
    "get_device_properties": (lambda: torch.cuda.get_device_properties(0).name, "cpu"),
    "mem_get_info": (lambda: torch.cuda.mem_get_info()[1] > 0, True),
    "random state": (lambda: torch.cuda.set_rng_state(torch.cuda.get_rng_state()), None),
    "a stream's wait": (
        lambda: torch.cuda.current_stream().wait_stream(torch.cuda.Stream(priority=-1)),
        None,
    ),
    "a stream's event": (lambda: torch.cuda.current_stream().record_event().query(), True),
    "a stream's end": (lambda: torch.cuda.default_stream().synchronize(), None),
    "the time of events": (lambda: _milliseconds() >= 0, True),
    "a scaler of gradients": (lambda: torch.cuda.amp.GradScaler(enabled=False).is_enabled(), False),
    "a generator's device": (lambda: torch.Generator("cuda").device.type, "cpu"),
    "a generator's type": (
        lambda: isinstance(torch.Generator(device="cuda"), torch.Generator),
        True,
    ),
}


def _in_a_block(block: AbstractContextManager[object]) -> Tensor:
    with block:
        return torch.ones(2, 2) @ torch.ones(2, 2)


def _of_default_device() -> Tensor:
    torch.set_default_device("cuda")
    try:
        return torch.ones(2)
    finally:
        torch.set_default_device(None)


def _recorded(tensor: Tensor) -> Tensor:
    tensor.record_stream(torch.cuda.current_stream())
    return tensor


def _milliseconds() -> float:
    start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    start.record()
    end.record()
    end.synchronize()
    return start.elapsed_time(end)


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::UserWarning")
@pytest.mark.parametrize("name", DRIVER_CALLS)
def test_a_call_into_the_driver_returns_at_once(name: str) -> None:
    call, expected = DRIVER_CALLS[name]
    with on_cpu():
        result = call()
    assert expected is None or result == expected


def test_the_driver_is_asked_again_after_the_outermost_block() -> None:
    before = {name: getattr(torch.cuda, name) for name in dir(torch.cuda)}
    generator = torch.Generator
    with on_cpu():
        with on_cpu():
            pass
        assert torch.cuda.synchronize is not before["synchronize"]
    assert {name: getattr(torch.cuda, name) for name in dir(torch.cuda)} == before
    assert torch.Generator is generator


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::UserWarning")
@pytest.mark.parametrize("name", CALLS)
def test_a_tensor_that_is_sent_to_cuda_stays_on_the_cpu(name: str) -> None:
    with on_cpu():
        assert CALLS[name]().device.type == "cpu"


def test_dtypes_and_other_devices_are_kept() -> None:
    with on_cpu():
        assert torch.ones(2).to("cuda", torch.float64).dtype == torch.float64
        assert torch.zeros(2, device="meta").device.type == "meta"


def test_a_decorated_function_may_call_itself() -> None:
    @on_cpu()
    def count(depth: int) -> int:
        assert torch.ones(1).cuda().device.type == "cpu"
        return depth if depth == 3 else count(depth + 1)

    assert count(0) == 3


def test_outside_of_the_block_torch_is_as_before() -> None:
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    with on_cpu():
        torch.ones(1).cuda()
    with pytest.raises((AssertionError, RuntimeError)):
        torch.ones(1).cuda()


class OnAGpu(GaussianGenerator):
    """As training code has it: the device is written out."""

    inputs = (inputs.time(),)

    def __init__(self) -> None:
        super().__init__()
        self.rest = torch.rand(8, 3, device="cuda")

    def forward(self, time: Tensor) -> Gaussians:
        ones = torch.ones(8, 3, device="cuda")
        turn = torch.tensor([[1.0, 0, 0, 0]]).cuda().repeat(8, 1)
        return Gaussians(self.rest + time, 0.5 * ones[:, 0], 0.1 * ones, turn, rgb=0.5 * ones)


def test_a_module_that_names_cuda_in_forward_is_exported(tmp_path: Path) -> None:
    with on_cpu():
        module = OnAGpu()
    assert export(module, tmp_path / "m.onnx", verify="quick").parity.holds


@pytest.mark.parametrize("owner", [torch, torch.cuda, torch.cuda.nvtx], ids=lambda o: o.__name__)
def test_what_is_a_class_stays_one(owner: object) -> None:
    """Torch's tracer asks what is an instance of torch.cuda.device, StreamContext and others."""
    names = [name for name, value in vars(owner).items() if isinstance(value, type)]
    assert names or owner is torch.cuda.nvtx
    with on_cpu():
        assert [name for name in names if not isinstance(getattr(owner, name), type)] == []
