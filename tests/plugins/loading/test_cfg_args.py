"""`cfg_args`: what argparse prints is read without running it, paths and objects included."""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.reference_plugins.anchors import scaffold_gs_plugin
from gsgen.reference_plugins.loading.cfg_args import CfgArgs, PrintedObject, read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.options import report_checkpoint
from gsgen.reference_plugins.synthetic import AnchorOptions, write_scaffold


def read_cfg(folder: Path, text: str) -> CfgArgs:
    (folder / "cfg_args").write_text(text, "utf-8")
    return read_cfg_args(folder)


class Odd:
    """Something that has no literal, and says so as Python does: <…>."""

    def __init__(self, text: str = "an odd one") -> None:
        self.text = text

    def __repr__(self) -> str:
        return f"<{self.text}>"


# ===== What is read


def test_literals_are_read_and_unknown_ones_do_no_harm(tmp_path: Path) -> None:
    text = "Namespace(a=1, b=-2.5, c='x', d=True, e=None, f=[1, 2], g={'k': [3]})"
    cfg = read_cfg(tmp_path, text)
    assert cfg.values == {
        "a": 1, "b": -2.5, "c": "x", "d": True, "e": None, "f": [1, 2], "g": {"k": [3]},
    }  # fmt: skip
    assert (cfg.integer("a", 0), cfg.number("a", 0), cfg.flag("zz", default=True)) == (1, 1, True)


def test_non_literal_reprs_are_read(tmp_path: Path) -> None:
    """As argparse prints infinities, and options whose names are not identifiers."""
    printed = Namespace(far=float("inf"), near=[-float("inf")], **{"some-key": 3})
    assert repr(printed) == "Namespace(far=inf, near=[-inf], **{'some-key': 3})"
    cfg = read_cfg(tmp_path, repr(printed))
    assert cfg.values == {"far": np.inf, "near": [-np.inf], "some-key": 3}
    assert np.isnan(read_cfg(tmp_path, "Namespace(a=nan)").number("a", 0))


def test_paths_are_their_text_wherever_they_stand(tmp_path: Path) -> None:
    printed = Namespace(
        source_path=Path("/data/my scene's"),
        test=[PureWindowsPath("C:/x"), (PurePosixPath("a"), {"k": PurePath("b")})],
        **{"out-dir": Path("o")},
    )
    assert repr(printed).count("Path(") == 5
    cfg = read_cfg(tmp_path, repr(printed))
    assert cfg.word("source_path", "") == "/data/my scene's"
    assert cfg.values["test"] == ["C:/x", ("a", {"k": "b"})]
    assert cfg.values["out-dir"] == "o"
    assert not cfg.printed_objects()
    assert read_cfg(tmp_path, "Namespace(a=WindowsPath('x'), b=Path('y'))").values == {
        "a": "x",
        "b": "y",
    }


# Everything that argparse may print: literals, paths, objects, and those within one another.
_LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=6), st.binary(max_size=4),
    st.text(max_size=6).map(PurePosixPath), st.text(max_size=6).map(PureWindowsPath),
)  # fmt: skip
_VALUES = st.recursive(
    _LEAVES,
    lambda children: st.one_of(
        st.lists(children, max_size=3),
        st.lists(children, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=4), children, max_size=3),
    ),
    max_leaves=6,
)
_NAMES = st.one_of(
    st.text(max_size=6), st.sampled_from(["source_path", "lambda", "ﬀ", "two words", "None", "<a>"])
)


def plain(value: Any) -> Any:
    """Turn paths within a value into their texts."""
    if isinstance(value, PurePath):
        return value.as_posix()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(map(plain, value))
    return value


def in_order(options: dict[str, Any]) -> str:
    """As text: NaN is not equal to itself, and −0 is equal to 0."""
    return repr({name: options[name] for name in sorted(options)})


@settings(max_examples=150, deadline=None)
@given(st.dictionaries(_NAMES, _VALUES, max_size=5))
def test_printed_namespace_round_trips(
    tmp_path_factory: pytest.TempPathFactory, options: dict[str, Any]
) -> None:
    cfg = read_cfg(tmp_path_factory.getbasetemp(), repr(Namespace(**options)))
    assert in_order(cfg.values) == in_order(plain(options))


@settings(max_examples=100, deadline=None)
@given(
    st.dictionaries(st.sampled_from("abcd"), _LEAVES, max_size=3),
    st.text(st.characters(exclude_characters="<>\n\r", exclude_categories=["Cs"]), max_size=9),
)
def test_objects_within_others_are_their_option_s_text(
    tmp_path_factory: pytest.TempPathFactory, options: dict[str, Any], printed_text: str
) -> None:
    printed = Namespace(**options, odd=Odd(printed_text), listed=[1, Odd(printed_text)])
    cfg = read_cfg(tmp_path_factory.getbasetemp(), repr(printed))
    assert cfg.printed_objects() == {
        "odd": PrintedObject(f"<{printed_text}>"),
        "listed": PrintedObject(f"[1, <{printed_text}>]"),
    }
    literals = {name: value for name, value in cfg.values.items() if name in options}
    assert in_order(literals) == in_order(plain(options))


# ===== What is not


@pytest.mark.parametrize(
    "value",
    [
        "__import__('os').system('touch ran')",
        "[x for x in (1,)]",
        "device(type='cuda', index=0)",
        "[1, PosixPath(open('ran', 'w'))]",
        "PosixPath('a', b='c')",
        "pathlib.PosixPath('a')",
        "torch.float32",
        "array([1, 2])",
        "<function main at 0x7f0123456789>",
        "<Mode.FAST: 1>",
        "-" * 20_000 + "1",
    ],
)
def test_required_option_without_a_literal_is_refused(
    value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        cfg = read_cfg(tmp_path, f"Namespace(a={value}, b=2, **{{'c-d': {value}}})")
    except CheckpointInvalid:  # Python's own limits of depth
        if value[0] != "-":
            raise
        return
    assert cfg.integer("b", 0) == 2
    assert list(cfg.printed_objects()) == ["a", "c-d"]
    for read_option in (
        lambda: cfg.flag("a"),
        lambda: cfg.word("a", ""),
        lambda: cfg.number("a", 0),
        lambda: cfg.integer("a", 0),
    ):
        with pytest.raises(CheckpointInvalid, match=r"a is .*, expected") as caught:
            read_option()
        assert value[:60] in str(caught.value)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("__import__('os').system('touch ran')", "is not a printed Namespace"),
        ("Namespace(1, 2)", "is not a printed Namespace"),
        ("Namespace(**{'a': 1})", "is not a printed Namespace"),
        ("Namespace(**x)", "is not a printed Namespace"),
        ("Namespace(a=1", "cannot be parsed"),
        ("Namespace(a=<x>, b=)", "cannot be parsed"),
        ("Namespace(a=<x <y> z>)", "cannot be parsed"),
        ("", "cannot be parsed"),
        ("Namespace(a=" + "-" * 100_000 + "1)", "cannot be parsed"),
        (
            "Namespace(a='" + "x" * (1 << 20) + "')",
            "has 1,048,591 bytes, expected at most 1,048,576",
        ),
    ],
)
def test_text_other_than_a_namespace_is_refused(
    text: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CheckpointInvalid, match=words):
        read_cfg(tmp_path, text)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("original_frame", "words"),
    [
        (lambda c: c.flag("a"), "a is 1, expected True or False"),
        (lambda c: c.integer("b", 0), "b is 'x', expected a whole number"),
        (lambda c: c.number("d", 0), "d is True, expected a number"),
        (lambda c: c.word("b", "y", ("y", "z")), "b is 'x', expected 'y' or 'z'"),
    ],
)
def test_an_option_of_another_kind_is_refused(
    original_frame: Callable, words: str, tmp_path: Path
) -> None:
    cfg = read_cfg(tmp_path, "Namespace(a=1, b='x', d=True)")
    with pytest.raises(CheckpointInvalid, match=words):
        original_frame(cfg)


def test_unused_options_are_warned_about_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg = read_cfg(tmp_path, "Namespace(a=1, b=PosixPath('/x'), device=device('cpu'))")
    report_checkpoint("a run", cfg)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "a run",
        f"warning: device=device('cpu') in {cfg.path} is not a literal and was ignored",
    ]


def test_a_run_with_paths_and_objects_in_its_options_is_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write_scaffold(tmp_path / "run", AnchorOptions(anchors=3))
    path = run / "cfg_args"
    whole = path.read_text().replace("'/data/scene'", "PosixPath('/data/scene')")
    assert "PosixPath" in whole
    path.write_text(whole.replace("eval=True", "eval=True, device=device(type='cuda')"))
    assert scaffold_gs_plugin.build(run).producer is not None
    assert "warning: device=device(type='cuda')" in capsys.readouterr().err
    path.write_text(path.read_text().replace("feat_dim=", "feat_dim=int(4) or "))
    with pytest.raises(CheckpointInvalid, match=r"feat_dim is int\(4\) or"):
        scaffold_gs_plugin.build(run)
