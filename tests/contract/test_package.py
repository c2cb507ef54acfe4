import subprocess
import sys

import pytest

import gsgen.contract


@pytest.mark.parametrize("name", gsgen.contract.__all__)
def test_every_public_name_is_there(name):
    vars(gsgen.contract).pop(name, None)
    assert getattr(gsgen.contract, name) is getattr(gsgen.contract, name)


def test_unknown_attribute_raises():
    with pytest.raises(AttributeError, match=r"module 'gsgen.contract' has no attribute 'nothing'"):
        gsgen.contract.nothing  # noqa: B018


def test_importing_the_contract_imports_nothing_else():
    code = "import sys, gsgen.contract; print('onnx' in sys.modules, 'numpy' in sys.modules)"
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert completed.stdout.split() == [b"False", b"False"]
