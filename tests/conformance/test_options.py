"""Settings from words, as every front end takes them."""

from pathlib import Path

import pytest

from gsgen.conformance.options import make_settings, needed_by
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.finding import Level, Severity
from gsgen.contract.installed import installed_rules


def test_words_win_over_the_file_of_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert make_settings().source == "defaults"
    text = '[validate]\ntarget = "webgpu"\nlevel = "static"\nfail_on = "warning"\n'
    Path("gsgen.toml").write_text(text)
    found = make_settings(level="values")
    assert (found.target.name, found.source) == ("webgpu", "gsgen.toml")
    assert (found.level, found.fail_on) == (Level.VALUES, Severity.WARNING)
    Path("other.toml").write_text('[validate]\ntarget = "visionary"\n')
    other = make_settings(config=Path("other.toml"))
    assert (other.target.name, other.level) == ("visionary", Level.BEHAVIOUR)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"target": "webgpuu"}, "Did you mean 'webgpu'?"),
        ({"level": "behavior"}, "Did you mean 'behaviour'?"),
        ({"fail_on": "never"}, "unknown severity 'never'"),
        ({"config": Path("none.toml")}, "none.toml: cannot be read"),
    ],
)
def test_a_wrong_word_names_itself(words: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        make_settings(**words)
    assert message in str(caught.value)


def test_a_rule_comes_with_all_that_it_needs() -> None:
    registry = installed_rules()
    for rule in registry.rules.values():
        part = needed_by(rule, registry).rules
        assert rule.id in part
        assert all(need in part for one in part.values() for need in one.needs)
