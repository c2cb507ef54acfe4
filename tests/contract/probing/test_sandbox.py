import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid, HostProcessFailed
from gsgen.contract.probing import sandbox, sandbox_worker
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import Fault, execute
from gsgen.contract.process.child_status import signal_name
from gsgen.contract.process.limits import Limits
from support.models.small_models import model, save, weight

DOUBLE = model("double (float[2] x) => (float[2] y) { y = Add (x, x) }")
ENDLESS = model("""
endless (int64 turns) => (float[1] y) <float[1] one = {1}, bool yes = {1}> {
    y = Loop (turns, yes, one) <body = b (int64 i, bool c, float[1] v) => (bool d, float[1] w) {
        d = Identity (c)
        w = Mul (v, v)
    }>
}
""")
MEMORY_HUNGRY_MODEL = model(
    "greedy (int64[1] size) => (float[1] y) <int64[1] zero = {0}> "
    "{ all = ConstantOfShape (size) y = ReduceSum (all, zero) }"
)


def probe(**inputs):
    return Probe(label="test", inputs={name: np.asarray(value) for name, value in inputs.items()})


def pair(a, b):
    return probe(x=np.array([a, b], np.float32))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A place for models; whatever a test leaves in the temporary folder fails it."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    yield tmp_path
    assert list(temporary.iterdir()) == []


@pytest.fixture
def children(monkeypatch):
    """Every child that was started; one that still runs at the end fails the test."""
    started = []

    class Recorded(subprocess.Popen):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            started.append(self)

    monkeypatch.setattr(sandbox.subprocess, "Popen", Recorded)
    yield started
    assert started
    assert all(child.poll() is not None for child in started)


def test_a_model_runs_once_for_each_probe_in_order(folder, children):
    path = save(folder / "a.onnx", DOUBLE)
    probes = [pair(1, 2), pair(3, 4), pair(1, 2)]
    with execute(path, ["y"], probes, Limits()) as execution:
        assert execution.fault is None
        assert [run.probe for run in execution.runs] == [0, 1, 2]
        assert all(run.seconds >= 0 for run in execution.runs)
        assert 0 < sum(run.seconds for run in execution.runs) < execution.seconds
        assert execution.version
        outputs = [execution.samples[run.sample].outputs["y"] for run in execution.runs]
        np.testing.assert_array_equal(outputs, [[2, 4], [6, 8], [2, 4]])
    assert len(children) == 1


def test_runs_with_the_same_output_share_a_sample(folder):
    path = save(folder / "a.onnx", DOUBLE)
    probes = [pair(1, 2), pair(3, 4), pair(1, 2), pair(0.0, 0), pair(-0.0, 0)]
    with execute(path, ["y"], probes, Limits()) as execution:
        assert [run.sample for run in execution.runs] == [0, 1, 0, 2, 3]
        assert [sample.index for sample in execution.samples] == [0, 1, 2, 3]


def test_names_of_tensors_need_not_be_names_of_files(folder):
    text = "m (float[1] a, float[1] file) => (float[1] y) { y = Sub (a, file) }"
    proto = model(text)
    renamed = {"a": "a/../../b", "y": "C:\\con\n*"}
    for value in (*proto.graph.input, *proto.graph.output):
        value.name = renamed.get(value.name, value.name)
    proto.graph.node[0].input[0] = renamed["a"]
    proto.graph.node[0].output[0] = renamed["y"]
    path = save(folder / "a.onnx", proto)
    inputs = {renamed["a"]: np.ones(1, np.float32), "file": np.zeros(1, np.float32)}
    with execute(path, [renamed["y"]], [Probe(label="test", inputs=inputs)], Limits()) as execution:
        assert execution.fault is None
        assert execution.samples[0].outputs[renamed["y"]].tolist() == [1]


@pytest.mark.parametrize("shape", [(), (0,), (0, 10), (2, 3)])
def test_outputs_of_any_shape_come_back(folder, shape):
    dims = ", ".join(map(str, shape))
    path = save(
        folder / "a.onnx", model(f"m (float[{dims}] x) => (float[{dims}] y) {{ y = Neg (x) }}")
    )
    with execute(path, ["y"], [probe(x=np.ones(shape, np.float32))], Limits()) as execution:
        assert execution.fault is None
        np.testing.assert_array_equal(execution.samples[0].outputs["y"], -np.ones(shape))


def fault_of(path, outputs, probes, limits=Limits()):  # noqa: B008 - it is frozen
    with execute(path, outputs, probes, limits) as execution:
        return execution.fault, execution


@pytest.mark.usefixtures("children")
@pytest.mark.parametrize(
    ("text", "actual"),
    [
        ("m (float[1] x) => (seq(float[1]) y) { y = SequenceConstruct (x) }", "a list"),
        ("m (float[1] x) => (string[1] y) { y = Cast <to = 8> (x) }", "strings"),
    ],
)
def test_an_output_that_is_no_numeric_tensor_is_a_fault_with_its_name(folder, text, actual):
    path = save(folder / "a.onnx", model(text))
    fault, execution = fault_of(path, ["y"], [probe(x=np.ones(1, np.float32))])
    assert fault == Fault("run", f"output 'y' is {actual}, expected a numeric tensor", 0)
    assert execution.runs == ()


@pytest.mark.usefixtures("children")
def test_a_custom_operator_is_a_fault_of_loading(folder):
    proto = model("m (float[1] x) => (float[1] y) { y = Neg (x) }")
    proto.graph.node[0].domain = "com.example.custom"
    proto.opset_import.add(domain="com.example.custom", version=1)
    fault, execution = fault_of(
        save(folder / "a.onnx", proto), ["y"], [probe(x=np.ones(1, np.float32))]
    )
    assert fault.stage == "load"
    assert "com.example.custom" in fault.message
    assert execution.runs == ()


def test_a_file_that_is_no_model_is_a_fault_of_loading(folder):
    path = folder / "a.onnx"
    path.write_bytes(b"Hello, world!")
    fault, execution = fault_of(path, ["y"], [pair(1, 2)])
    assert (fault.stage, fault.probe) == ("load", None)
    assert fault.message == "is not an ONNX model but text that begins 'Hello, world!'"
    assert execution.events == ()
    assert execution.samples == ()


@pytest.mark.usefixtures("children")
def test_inputs_that_do_not_fit_are_a_fault_of_their_probe(folder):
    path = save(folder / "a.onnx", DOUBLE)
    probes = [pair(1, 2), probe(x=np.ones(3, np.float32)), pair(1, 2)]
    fault, execution = fault_of(path, ["y"], probes)
    assert (fault.stage, fault.probe) == ("run", 1)
    assert "invalid dimensions" in fault.message
    assert "\n" not in fault.message
    assert len(execution.runs) == 1


def test_a_model_that_never_ends_is_stopped_and_what_it_did_is_kept(folder, children):
    path = save(folder / "a.onnx", ENDLESS)
    probes = [probe(turns=np.int64(2)), probe(turns=np.int64(2**62))]
    fault, execution = fault_of(path, ["y"], probes, Limits(seconds=3))
    assert fault == Fault("time", "still running after 3 s", 1)
    assert len(execution.runs) == 1
    assert 3 <= execution.seconds < 8 * 3 + 10  # other work may take the processor
    assert children[0].returncode == -signal.SIGKILL


@pytest.mark.usefixtures("children")
def test_a_model_that_takes_too_much_memory_is_a_fault_of_memory(folder):
    path = save(folder / "a.onnx", MEMORY_HUNGRY_MODEL)
    probes = [probe(size=np.array([4])), probe(size=np.array([1 << 28]))]
    fault, execution = fault_of(path, ["y"], probes, Limits(memory=512 << 20))
    assert (fault.stage, fault.probe) == ("memory", 1)
    assert len(execution.runs) == 1


def act_on_first_wait(monkeypatch, action):
    """Let ``action(child, folder)`` stand for the first wait; the child itself is the real one."""

    class Acting(subprocess.Popen):
        has_acted = False

        def wait(self, timeout=None):
            if not self.has_acted:
                self.has_acted = True
                action(self, Path(self.args[-1]))
            return super().wait(timeout)

    monkeypatch.setattr(sandbox.subprocess, "Popen", Acting)


def until_it_runs(folder):
    events = folder / "events.jsonl"
    deadline = time.monotonic() + 30
    while not (events.exists() and '"begin"' in events.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_crash_names_its_signal_and_probe(folder, monkeypatch):
    def crash(child, where):
        until_it_runs(where)
        child.send_signal(signal.SIGSEGV)

    act_on_first_wait(monkeypatch, crash)
    path = save(folder / "a.onnx", ENDLESS)
    fault, _ = fault_of(path, ["y"], [probe(turns=np.int64(2**62))])
    assert fault == Fault("crash", "ended by signal SIGSEGV", 0)


def test_child_that_cannot_start_reports_its_last_stderr_line(folder, monkeypatch):
    monkeypatch.setattr(sandbox, "_write_job", lambda *_, **options: None)
    expected_message = "ended: exit status 1: FileNotFoundError: "
    with pytest.raises(HostProcessFailed, match=expected_message):
        fault_of(save(folder / "a.onnx", DOUBLE), ["y"], [pair(1, 2)])


def test_a_half_written_event_is_the_end_and_no_error(folder, monkeypatch):
    def cut(child, where):
        while child.poll() is None:
            time.sleep(0.02)
        events = where / "events.jsonl"
        events.write_text(events.read_text() + '{"event": "ru')

    act_on_first_wait(monkeypatch, cut)
    fault, execution = fault_of(save(folder / "a.onnx", DOUBLE), ["y"], [pair(1, 2)])
    assert fault is None
    assert len(execution.runs) == 1


def test_an_interrupt_leaves_no_child_and_no_files(folder, monkeypatch):
    recorded = []

    def interrupt(child, where):
        until_it_runs(where)
        recorded.append(child)
        raise KeyboardInterrupt

    act_on_first_wait(monkeypatch, interrupt)
    path = save(folder / "a.onnx", ENDLESS)
    with pytest.raises(KeyboardInterrupt):
        fault_of(path, ["y"], [probe(turns=np.int64(2**62))])
    assert recorded[0].poll() == -signal.SIGKILL


_ENDLESSLY = """
import sys
from pathlib import Path
import numpy as np
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.child_status import signal_name
from gsgen.contract.process.limits import Limits
with execute(Path(sys.argv[1]), ["y"], [Probe(label="a", inputs={"turns": np.int64(2**62)})], Limits()):
    pass
"""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked up in /proc")
def test_a_child_ends_soon_after_a_parent_that_was_killed(folder):
    path = save(folder / "a.onnx", ENDLESS)
    own = folder / "own"
    own.mkdir()
    environment = os.environ | {"TMPDIR": str(own)}
    parent = subprocess.Popen([sys.executable, "-c", _ENDLESSLY, path], env=environment)
    try:
        # tempfile writes a file of another name before, to see whether it may.
        while not list(own.glob("gsgen-*")):
            assert parent.poll() is None
            time.sleep(0.02)
        (where,) = own.glob("gsgen-*")
        until_it_runs(where)
        assert running(where)
    finally:
        parent.kill()
        parent.wait()
    deadline = time.monotonic() + 20
    while running(where):
        assert time.monotonic() < deadline, "the child outlives its parent"
        time.sleep(0.05)


def running(folder):
    """Return the processes that have ``folder`` as an argument."""
    results = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().split(b"\0")
        except OSError:  # it ended in the meantime
            continue
        if str(folder).encode() in words:
            results.append(entry.parent.name)
    return results


def test_unnamed_signal_is_reported_by_number():
    assert signal_name(9) == "SIGKILL"
    assert signal_name(250) == "250"


_UNDER_A_LIMIT = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_DATA, (1 << 30, 1 << 30))
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.child_status import signal_name
from gsgen.contract.process.limits import Limits
with execute(Path(sys.argv[1]), ["y"], [], Limits()) as execution:
    sys.exit(str(execution.fault) if execution.fault else 0)
"""


def test_outputs_that_exceed_the_disk_limit_are_not_stored(folder):
    job_folder = folder / "job"
    job_folder.mkdir()
    outputs = {"y": np.zeros(1 << 16, np.float32)}
    with pytest.raises(OSError, match="more than 0 MiB, four times the memory limit"):
        sandbox_worker.keep_outputs(job_folder, outputs, {}, lambda *_, **__: None, disk=1 << 17)
    assert list(job_folder.iterdir()) == []
    sandbox_worker.keep_outputs(job_folder, outputs, {}, lambda *_, **__: None, disk=1 << 19)
    with pytest.raises(OSError, match="four times"):
        sandbox_worker.keep_outputs(
            job_folder, {"y": outputs["y"] + 1}, {}, lambda *_, **__: None, disk=1 << 19
        )


@pytest.mark.usefixtures("children")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_child_killed_from_outside_is_a_fault_of_the_host(folder, monkeypatch, number):
    def kill(child, where):
        until_it_runs(where)
        child.send_signal(number)

    act_on_first_wait(monkeypatch, kill)
    path = save(folder / "a.onnx", ENDLESS)
    with pytest.raises(HostProcessFailed, match=f"killed by {number.name}") as caught:
        fault_of(path, ["y"], [probe(turns=np.int64(2**62))])
    assert caught.value.exit_code == 2


# Sets a limit of this process, as `ulimit` does, and prints what a sandbox in it raises.
_WITH_A_LIMIT = """
import resource, sys
from pathlib import Path
import numpy as np
from gsgen.contract.errors import HostProcessFailed
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
limit, size = getattr(resource, sys.argv[2]), int(sys.argv[3])
resource.setrlimit(limit, (size, size))
probe = Probe(label="", inputs={"x": np.ones((1 << 16, 10), np.float32)})
try:
    with execute(Path(sys.argv[1]), ["y"], [probe], Limits()) as execution:
        print(execution.fault)
except HostProcessFailed as error:
    print(error.message)
"""


@pytest.mark.skipif(os.name != "posix", reason="no resource limits on this system")
@pytest.mark.parametrize(
    ("limit", "size", "cause"),
    [
        ("RLIMIT_FSIZE", 2_700_000, "cannot be stored: a part was written"),
        ("RLIMIT_DATA", 160 << 20, "limited to 160 MiB"),
    ],
)
def test_a_full_disk_and_refused_memory_are_faults_of_the_host(folder, limit, size, cause):
    text = (
        "m (float[65536,10] x) => (float[65536,20] y, float[1] z) <int64[2] n = {32, 1}> "
        "{ t = Tile (x, n) s = Sin (t) z0 = ReduceMax <keepdims = 0> (s) "
        "z = Unsqueeze (z0, axis) y = Concat <axis = 1> (x, x) }"
    )
    path = save(folder / "a.onnx", model(text, weight("axis", np.zeros(1, np.int64))))
    completed = subprocess.run(
        [sys.executable, "-c", _WITH_A_LIMIT, path, limit, str(size)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert cause in completed.stdout


@pytest.mark.skipif(os.name != "posix", reason="no resource limits on this system")
def test_a_limit_of_the_system_below_ours_is_no_fault_of_the_model(folder):
    path = save(folder / "a.onnx", DOUBLE)
    completed = subprocess.run(
        [sys.executable, "-c", _UNDER_A_LIMIT, path], capture_output=True, text=True, check=False
    )
    assert (completed.returncode, completed.stderr) == (0, "")


def test_limit_beyond_the_system_range_means_unlimited(folder):
    path = save(folder / "a.onnx", DOUBLE)
    fault, _ = fault_of(path, ["y"], [pair(1, 2)], Limits(memory=1 << 70))
    assert fault is None


@pytest.mark.parametrize(
    ("seconds", "memory", "actual"),
    [
        (0, 1, "0 s and 1 bytes"),
        (-1, 1, "-1 s and 1 bytes"),
        (float("nan"), 1, "nan s and 1 bytes"),
        (1, 0, "1 s and 0 bytes"),
    ],
)
def test_limits_are_above_zero(seconds, memory, actual):
    with pytest.raises(ConfigInvalid) as caught:
        Limits(seconds, memory)
    assert str(caught.value) == f"limits: time and memory are {actual}, expected limits above 0"


def test_weights_are_allowed_on_top_of_the_limit():
    limits = Limits(seconds=7, memory=1000).for_model(100)
    assert (limits.seconds, limits.memory) == (7, 1500)


def test_the_job_is_plain_data(folder):
    path = save(folder / "a.onnx", DOUBLE)
    sandbox._write_job(folder, path, ["y"], [pair(1, 2)], Limits(memory=5))
    job = json.loads((folder / "job.json").read_text())
    assert job == {
        "model": str(path),
        "outputs": ["y"],
        "probes": [[["x", 0]]],
        "extra": [False],
        "survey": [False],
        "pictured": [False],
        "placements": [None],
        "optimise": [True],
        "memory": 5,
        "disk": 20,
        "seconds": 120.0,
    }


FOLDED = model("""
look (float[1, 2] x) => (float[1, 2] y) <float[2, 2] w = {1, 2, 3, 4}> {
    turned = Transpose (w)
    y = MatMul (x, turned)
}
""")


FOLDED_HALVES = model("""
look (float[1, 2] x) => (float[1, 2] y) {
    wide = Cast <to = 1> (w)
    turned = Transpose (wide)
    y = MatMul (x, turned)
}
""")
FOLDED_HALVES.graph.initializer.append(weight("w", np.float16([[1, 2], [3, 4]])))


@pytest.mark.parametrize("proto", [FOLDED, FOLDED_HALVES], ids=["float32", "float16"])
@pytest.mark.parametrize("maps_weights", [False, True])
def test_mapped_weights_give_the_same_outputs(folder, proto, maps_weights):
    path = save(folder / "a.onnx", proto)
    x = np.float32([[1, 2]])
    facts = {"maps_weights": maps_weights, "has_float16_weights": proto is FOLDED_HALVES}
    with execute(path, ["y"], [probe(x=x)], Limits(), **facts) as execution:
        np.testing.assert_array_equal(execution.samples[0].outputs["y"], [[5, 11]])


ROOT_OF_INDEX = model("""
look (float[1] x) => (float[1] y) <float[2] table = {1, 4}> {
    row = Cast <to = 6> (x)
    y = Gather (table, row)
}
""")


def test_an_extra_probe_that_fails_is_no_fault_of_the_model(folder):
    path = save(folder / "a.onnx", ROOT_OF_INDEX)
    far = np.float32([9])
    probes = [probe(x=np.float32([1])), Probe(label="far", inputs={"x": far}, extra=True)]
    with execute(path, ["y"], probes, Limits()) as execution:
        assert execution.fault is None
        assert [run.sample for run in execution.runs] == [0, -1]
        assert "out of data bounds" in execution.runs[1].error
    with execute(path, ["y"], [probe(x=far)], Limits()) as execution:
        assert execution.fault.stage == "run"


@pytest.mark.parametrize(("seconds", "missing_extra"), [(1e-9, "time"), (60.0, "memory")])
def test_an_extra_probe_that_a_limit_does_not_allow_has_no_outputs(
    seconds, missing_extra, folder, monkeypatch
):
    path = save(folder / "a.onnx", DOUBLE)
    extra = replace(pair(3, 4), label="extra", extra=True)
    job_folder, events = folder / "job", []
    job_folder.mkdir()
    limits = Limits(seconds=seconds)
    keep_outputs = sandbox_worker.keep_outputs

    def keep(*arguments, thin, **options):
        if thin:
            raise MemoryError("Unable to allocate 206. MiB")
        return keep_outputs(*arguments, **options)

    monkeypatch.setattr(sandbox_worker, "keep_outputs", keep)
    sandbox._write_job(job_folder, path, ["y"], [pair(1, 2), extra], limits, rows="", count="")
    job = json.loads((job_folder / "job.json").read_text("utf-8"))
    monkeypatch.setattr(sandbox_worker, "limit_memory", lambda _: None)
    sandbox_worker._run_probes(
        job_folder, job, lambda event, **facts: events.append((event, facts))
    )
    runs = [facts for event, facts in events if event == "run"]
    assert [(facts["probe"], facts["sample"]) for facts in runs] == [(0, 0), (1, -1)]
    assert runs[1]["missing_resource"] == missing_extra
    assert "error" not in runs[1]  # it says nothing about the model


def test_extra_probe_keeps_a_sample_of_rows_and_nonfinite_ones(folder):
    rows = 1 << 16
    text = f"root (float[{rows},1] x) => (float[{rows},1] y) {{ y = Sqrt (x) }}"
    path = save(folder / "a.onnx", model(text))
    x = np.arange(rows, dtype=np.float32)[:, None]
    x[5] = -1
    probes = [Probe(label="part", inputs={"x": x}, extra=True, optimise=False)]
    with execute(path, ["y"], probes, Limits()) as execution:
        (sample,) = execution.samples
        assert sample.thin
        assert sample.not_finite == ("y",)
        np.testing.assert_array_equal(sample.outputs["y"], np.sqrt(x[::4]))


def test_time_within_onnx_runtime_is_part_of_the_time_of_its_process(folder):
    path = save(folder / "a.onnx", DOUBLE)
    probe = Probe(label="plain", inputs=pair(1, 2).inputs, extra=True, optimise=False)
    with execute(path, ["y"], [pair(1, 2), probe], Limits()) as execution:
        loads = [event for event in execution.events if event["event"] == "loaded"]
        assert len(loads) == 2  # another session for the run without optimisations
        runs = sum(run.seconds for run in execution.runs)
        assert 0 < runs < execution.session_seconds < execution.seconds


def test_lost_output_names_its_probe_after_a_session_restart(folder):
    (folder / "log").write_text("")
    events = [{"event": "started"}, {"event": "loaded"}, {"event": "begin", "probe": 3}]
    for last in ([], [{"event": "loaded"}], [{"event": "sample"}]):
        fault = sandbox._read_fault_report(
            [*events, *last], -11, Limits(), folder / "log", is_own_model=True
        )
        assert (fault.stage, fault.probe) == ("crash", 3)
    done = [*events, {"event": "run", "probe": 3}]
    fault = sandbox._read_fault_report(done, -11, Limits(), folder / "log", is_own_model=True)
    assert fault.probe is None
