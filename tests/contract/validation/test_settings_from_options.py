"""Settings from words, as every front end takes them."""

from pathlib import Path

import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.settings_from_options import make_settings

REGISTRY = installed_rules()


def test_options_take_precedence_over_the_file_of_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert make_settings(REGISTRY).source == "defaults"
    text = '[validate]\ntarget = "webgpu"\nlevel = "static"\nfail_on = "warning"\n'
    Path("gsgen.toml").write_text(text, encoding="utf-8")
    settings = make_settings(REGISTRY, level="values")
    assert (settings.target.name, settings.source) == ("webgpu", "gsgen.toml")
    assert (settings.level, settings.fail_on) == (Level.VALUES, Severity.WARNING)
    Path("other.toml").write_text('[validate]\ntarget = "visionary"\n', encoding="utf-8")
    unchanged = make_settings(REGISTRY, config=Path("other.toml"))
    assert (unchanged.target.name, unchanged.level) == ("visionary", Level.BEHAVIOUR)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"target": "webgpuu"}, "Did you mean 'webgpu'?"),
        ({"level": "behavior"}, "--level: unknown level 'behavior'\n  Did you mean 'behaviour'?"),
        ({"fail_on": "never"}, "unknown severity 'never'"),
        ({"ignore": ["GV003,GV03"]}, "--ignore: unknown rule 'GV03'"),
        ({"severity": ["GV003"]}, "--severity: 'GV003' has no '='"),
        ({"severity": ["GV003=bad"], "prefix": "--gsgen-"}, "--gsgen-severity: unknown"),
        ({"timeout": 0.0}, "expected limits above 0"),
        ({"config": Path("none.toml")}, "none.toml: the settings file cannot be read"),
    ],
)
def test_invalid_option_value_is_named(words: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        make_settings(REGISTRY, **words)
    assert message in str(caught.value)


def test_every_option_takes_effect() -> None:
    settings = make_settings(
        REGISTRY,
        ignore=["GV003,mostly-visible", "gm001"],
        severity=["GV005=info"],
        timeout=3.5,
        memory=70,
        strict=True,
        seed=4,
    )
    assert settings.ignore >= {"GV003", "GV004", "GM001"}
    assert dict(settings.severities) == {"GV005": Severity.INFO}
    assert (settings.limits.seconds, settings.limits.memory) == (3.5, 70 << 20)
    assert (settings.strict, settings.seed) == (True, 4)
