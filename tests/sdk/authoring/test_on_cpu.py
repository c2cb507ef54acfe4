"""Code that names CUDA runs on the CPU."""

from collections.abc import Callable
from pathlib import Path

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
    "new_zeros": lambda: torch.ones(2).new_zeros(3, device="cuda"),
}


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
