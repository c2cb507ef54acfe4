"""`GeneratorConformance`: a class whose fixtures an author overrides."""

from pathlib import Path

from conformance.pytest_runs import run_pytest, write

HEAD = """
import pytest
from pathlib import Path
from gsgen.conformance import GeneratorConformance

HERE = Path(__file__).parent
"""


def test_a_class_with_one_fixture_tests_every_rule(folder: Path) -> None:
    write(folder, "camera_and_proj")
    text = """
class TestMine(GeneratorConformance):
    @pytest.fixture(scope="class")
    def model(self):
        return HERE / "camera_and_proj.onnx"
"""
    (folder / "test_mine.py").write_text(HEAD + text)
    completed = run_pytest(folder, "--gsgen-level=values")
    assert completed.code == 0, completed.out
    assert set(completed.counts) == {"passed", "skipped"}
    node_prefix = "test_mine.TestMine::"
    passed = completed.names("passed")
    assert f"{node_prefix}test_camera[GI001-view-is-4x4]" in passed
    assert f"{node_prefix}test_basic[GV003-opacity-range]" in passed
    assert f"{node_prefix}test_time[GI003-time-is-1]" in completed.names("skipped")
    assert "suite time is not for what it declares" in completed.out
    assert "::GeneratorConformance" not in completed.out


def test_every_fixture_can_be_overridden(folder: Path) -> None:
    write(folder, "opacity_is_logits")
    text = """
from gsgen.conformance.expected import ExpectedFailure

class TestMine(GeneratorConformance):
    test_basic = None

    @pytest.fixture
    def model(self):
        return HERE / "opacity_is_logits.onnx"

    @pytest.fixture
    def target(self):
        return "webgpu"

    @pytest.fixture
    def level(self):
        return "static"

    def test_mine(self, settings, conformance):
        assert settings.target.name == "webgpu"
        assert conformance.report.level.word == "static"


class TestKnown(GeneratorConformance):
    @pytest.fixture
    def model(self):
        return HERE / "opacity_is_logits.onnx"

    @pytest.fixture
    def expected_failures(self):
        return [ExpectedFailure("GV003", "logits until 2.0")]


class TestForgotten(GeneratorConformance):
    pass


class TestEmpty(GeneratorConformance):
    @pytest.fixture
    def model(self):
        return HERE / "nothing.onnx"
"""
    (folder / "test_mine.py").write_text(HEAD + text)
    completed = run_pytest(folder, "-k", "TestMine or GV003", "--gsgen-level=values")
    assert completed.code == 1
    assert "test_mine.TestMine::test_mine" in completed.names("passed")
    assert not [name for name in completed.cases if "TestMine::test_basic" in name]
    assert completed.names("xfailed") == ["test_mine.TestKnown::test_basic[GV003-opacity-range]"]
    assert "TestForgotten must override the fixture `model`" in completed.out
    assert "nothing.onnx: cannot be read: No such file" in completed.out
    assert "INTERNALERROR" not in completed.out


def test_a_broken_model_fails_with_a_line_that_shows_it_again(folder: Path) -> None:
    write(folder, "opacity_is_logits")
    text = """
class TestMine(GeneratorConformance):
    @pytest.fixture
    def model(self):
        return HERE / "opacity_is_logits.onnx"
"""
    (folder / "test_mine.py").write_text(HEAD + text)
    completed = run_pytest(folder, "--gsgen-level=values")
    assert completed.names("failure") == ["test_mine.TestMine::test_basic[GV003-opacity-range]"]
    assert "reproduce: gsgen repro opacity_is_logits.onnx --rule GV003" in completed.out


FAILING_BUILDERS_TEXT = """
from gsgen.contract.errors import GsgenError

def build():
    raise GsgenError("GV003 output gaussians: 4 of 5 rows", where="mine.onnx", hint="Squash it.")

class TestRefused(GeneratorConformance):
    @pytest.fixture
    def model(self):
        return build()

class TestCrashing(GeneratorConformance):
    @pytest.fixture
    def model(self):
        return {}["weights"]

class TestTwice(GeneratorConformance):
    @pytest.fixture(params=["camera_and_proj", "nothing"])
    def model(self, request):
        return HERE / f"{request.param}.onnx"

    def test_mine(self):
        pass
"""


def test_a_model_that_cannot_be_made_is_one_error_and_not_one_for_each_rule(folder: Path) -> None:
    write(folder, "camera_and_proj")
    (folder / "test_mine.py").write_text(HEAD + FAILING_BUILDERS_TEXT)
    completed = run_pytest(folder, "--gsgen-level=static")
    assert completed.code == 1
    errors = [name.partition("::")[0] for name in completed.names("error")]
    expected = ["TestRefused", "TestCrashing", "TestTwice"]
    assert errors == [f"test_mine.{name}" for name in expected]
    assert "test_mine.TestTwice::test_mine" in completed.names("passed")
    passed_line = "test_mine.TestTwice::test_camera[GI001-view-is-4x4-camera_and_proj]"
    assert passed_line in completed.names("passed")
    message = completed.out.partition("ERROR at setup of TestRefused")[2].partition("____ ERROR")[0]
    assert "mine.onnx: GV003 output gaussians: 4 of 5 rows\n  Squash it." in message
    assert "test_mine.py:16: return build()" in message
    assert "\nE  " not in message  # no traceback
    crash = completed.out.partition("ERROR at setup of TestCrashing")[2].partition("____ ERROR")[0]
    assert 'return {}["weights"]' in crash
    assert "KeyError: 'weights'" in crash
    assert "the model cannot be validated: see the error of test_" in completed.out
