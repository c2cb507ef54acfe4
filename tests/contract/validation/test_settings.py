from datetime import date

import pytest
from jsonschema import Draft202012Validator

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.process.limits import Limits
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target, load_target
from gsgen.contract.validation.settings import Settings, config_schema, read_config
from gsgen.contract.validation.waivers import Waiver

REGISTRY = installed_rules()
OPACITY = REGISTRY.find("GV003")


@pytest.fixture
def read(tmp_path):
    def write_and_read(text, base=None):
        (tmp_path / "gsgen.toml").write_text(text)
        return read_config(tmp_path / "gsgen.toml", REGISTRY, base)

    return write_and_read


def test_a_file_can_set_everything(read, tmp_path):
    settings = read(
        """
        [validate]
        level = "values"
        target = "webgpu@1.0"
        fail_on = "warning"
        ignore = ["GM001", "opacity-range"]
        timeout = 2.5
        memory_mib = 64
        strict = true
        seed = 7

        [severity]
        GV005 = "info"
        covariance-psd = "warning"
        gv007 = "error"
    """
    )
    assert settings == Settings(
        level=Level.VALUES,
        target=load_target("webgpu"),
        fail_on=Severity.WARNING,
        ignore=frozenset({"GM001", "GV003"}),
        severities={"GV005": Severity.INFO, "GV006": Severity.WARNING, "GV007": Severity.ERROR},
        limits=Limits(2.5, 64 << 20),
        strict=True,
        seed=7,
        source=str(tmp_path / "gsgen.toml"),
    )


def test_an_empty_file_changes_nothing_but_the_source(read, tmp_path):
    base = Settings(level=Level.STATIC, seed=3, ignore=frozenset({"GM001"}), strict=True)
    settings = read("", base)
    assert settings.source == str(tmp_path / "gsgen.toml")
    assert (settings.level, settings.seed, settings.strict) == (Level.STATIC, 3, True)
    assert settings.ignore == {"GM001"}
    assert settings.limits == base.limits


def test_ignored_rules_of_a_file_add_to_the_options(read):
    base = Settings(ignore=frozenset({"GM001"}), severities={"GV003": Severity.INFO})
    settings = read('[validate]\nignore = ["GV004"]\n[severity]\nGV004 = "info"\n', base)
    assert settings.ignore == {"GM001", "GV004"}
    assert settings.severities == {"GV003": Severity.INFO, "GV004": Severity.INFO}


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("[validte]\n", UnknownName, ": unknown key 'validte'\n  Did you mean 'validate'?"),
        (
            '[validate]\nlevle = "static"\n',
            UnknownName,
            ", validate: unknown key 'levle'\n  Did you mean 'level'?",
        ),
        (
            '[validate]\nignore = ["GV903"]\n',
            UnknownName,
            ", ignore: unknown rule 'GV903'\n  Did you mean 'GV0",
        ),
        (
            '[severity]\nopacity-rage = "info"\n',
            UnknownName,
            ", [severity]: unknown rule 'opacity-rage'\n  Did you mean 'opacity-range'?",
        ),
        (
            '[validate]\ntarget = "webgl"\n',
            UnknownName,
            ": unknown target 'webgl'\n  Did you mean 'webgpu'?",
        ),
        (
            '[validate]\ntarget = "webgpu@0.1"\n',
            ConfigInvalid,
            ": validation target webgpu has version 1.0, not 0.1",
        ),
        (
            '[validate]\nlevel = "all"\n',
            ConfigInvalid,
            ", validate.level: 'all' is not one of ['static', 'values', 'behaviour', ",
        ),
        (
            "[validate]\nfail_on = 3\n",
            ConfigInvalid,
            ", validate.fail_on: 3 is not one of ['info', 'warning', 'error']",
        ),
        (
            '[severity]\nGV003 = "fatal"\n',
            ConfigInvalid,
            ", severity.GV003: 'fatal' is not one of ['info', 'warning', 'error']",
        ),
        (
            "[severity]\ngv003 = 3\n",
            ConfigInvalid,
            ", severity.gv003: 3 is not one of ['info', 'warning', 'error']",
        ),
        (
            '[validate]\ntimeout = "long"\n',
            ConfigInvalid,
            ", validate.timeout: 'long' is not of type 'number'",
        ),
        (
            "[validate]\ntimeout = 0\n",
            ConfigInvalid,
            ", validate.timeout: 0 is less than or equal to the minimum of 0",
        ),
        (
            "[validate]\nmemory_mib = 63\n",
            ConfigInvalid,
            ", validate.memory_mib: 63 is less than the minimum of 64",
        ),
        (
            '[validate]\nignore = "GV003"\n',
            ConfigInvalid,
            ", validate.ignore: 'GV003' is not of type 'array'",
        ),
        ("validate = 3\n", ConfigInvalid, ", validate: 3 is not of type 'object'"),
        (
            "[validate\n",
            ConfigInvalid,
            ": the settings file is not TOML: Expected ']' at the end of a table declaration (at line 1, ",
        ),
    ],
)
def test_invalid_setting_is_an_error_with_its_location(read, tmp_path, text, error, message):
    with pytest.raises(error) as caught:
        read(text)
    assert str(caught.value).startswith(f"{tmp_path / 'gsgen.toml'}{message}")


def test_a_time_that_is_no_number_is_refused(read):
    with pytest.raises(ConfigInvalid, match=r"nan s and .* expected limits above 0"):
        read("[validate]\ntimeout = nan\n")


def test_a_file_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(ConfigInvalid) as caught:
        read_config(tmp_path / "absent.toml", REGISTRY)
    expected = (
        f"{tmp_path / 'absent.toml'}: the settings file cannot be read: No such file or directory"
    )
    assert str(caught.value) == expected


def test_undecodable_file_is_an_error(tmp_path):
    path = tmp_path / "gsgen.toml"
    path.write_bytes(b"\xff")
    with pytest.raises(ConfigInvalid, match="the settings file is not TOML: 'utf-8' codec"):
        read_config(path, REGISTRY)
    path.write_text("level = 'static'", "utf-16")
    with pytest.raises(ConfigInvalid, match="it is text in UTF-16, expected UTF-8"):
        read_config(tmp_path / "gsgen.toml", REGISTRY)


def test_the_schema_of_the_file_lists_every_rule_by_id_and_name():
    schema = config_schema(REGISTRY)
    Draft202012Validator.check_schema(schema)
    listed = schema["properties"]["severity"]["properties"]
    names = {name for rule in REGISTRY.rules.values() for name in (rule.id, rule.slug)}
    assert set(listed) == names
    assert listed["GV003"]["description"] == OPACITY.statement
    section = schema["properties"]["validate"]["properties"]
    assert set(section["ignore"]["items"]["examples"]) == names
    assert all("description" in entry for entry in section.values())


def target(**severities):
    return Target(
        name="t",
        version="1",
        summary="A test.",
        opset=(13, 20),
        ir=10,
        domains=frozenset({""}),
        limits={},
        severities=severities,
    )


@pytest.mark.parametrize(
    ("settings", "severity"),
    [
        (Settings(), Severity.ERROR),
        (Settings(target=target(GV003=Severity.WARNING)), Severity.WARNING),
        (
            Settings(target=target(GV003=Severity.WARNING), severities={"GV003": Severity.INFO}),
            Severity.INFO,
        ),
        (Settings(strict=True), Severity.ERROR),
    ],
)
def test_settings_win_over_the_target_which_wins_over_the_rule(settings, severity):
    assert settings.severity_of(OPACITY) == severity


def test_a_missing_manifest_is_an_error_unless_the_target_reads_none_or_settings_say_so():
    missing = REGISTRY.find("GM001")
    assert Settings().severity_of(missing) == Severity.ERROR
    visionary = load_target("visionary")
    assert Settings(target=visionary).severity_of(missing) == Severity.WARNING
    strict_settings = Settings(target=visionary, strict=True)
    assert strict_settings.severity_of(missing) == Severity.ERROR
    lenient = Settings(strict=True, severities={"GM001": Severity.INFO})
    assert lenient.severity_of(missing) == Severity.INFO


def test_a_file_can_waive_findings_with_a_reason(read, tmp_path):
    settings = read(
        """
        [[waive]]
        rule = "GV004"
        reason = " Dust, on purpose. "

        [[waive]]
        rule = "opacity-range"
        where = "output gaussians, opacity"
        model = "garden*.onnx"
        reason = "Until the next export."
        until = 2027-01-01

        [[waive]]
        rule = "gv005"
        reason = "Known."
        until = "2027-01-02"
    """
    )
    where, next_year = "output gaussians, opacity", date(2027, 1, 1)
    assert settings.waivers == (
        Waiver(rule="GV004", reason="Dust, on purpose."),
        Waiver(
            rule="GV003",
            reason="Until the next export.",
            where=where,
            model="garden*.onnx",
            until=next_year,
        ),
        Waiver(rule="GV005", reason="Known.", until=date(2027, 1, 2)),
    )
    assert settings.source == str(tmp_path / "gsgen.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('rule = "GV004"', ", waive.0: 'reason' is a required property"),
        ('reason = "x"', ", waive.0: 'rule' is a required property"),
        ('rule = "GV004"\nreason = " "', ", waive.0.reason: ' ' does not match"),
        (
            'rule = "opacity-rage"\nreason = "x"',
            ", waive.0.rule: unknown rule 'opacity-rage'\n  Did you mean 'opacity-range'?",
        ),
        (
            'rule = "GV004"\nreason = "x"\nuntill = 2027-01-01',
            ", waive.0: unknown key 'untill'\n  Did you mean 'until'?",
        ),
        (
            'rule = "GV004"\nreason = "x"\nuntil = "soon"',
            ", waive.0.until: 'soon' is not a date: expected one like 2027-01-01",
        ),
        (
            'rule = "GV004"\nreason = "x"\nuntil = 2027-01-01T00:00:00',
            ", waive.0.until: datetime.datetime(2027, 1, 1, 0, 0) is not of type 'string'",
        ),
        ('rule = "GV004"\nreason = "x"\nuntil = 3', ", waive.0.until: 3 is not of type 'string'"),
    ],
)
def test_invalid_waiver_is_an_error(read, tmp_path, text, message):
    with pytest.raises(ConfigInvalid) as caught:
        read(f"[[waive]]\n{text}\n")
    assert str(caught.value).startswith(f"{tmp_path / 'gsgen.toml'}{message}")


@pytest.mark.parametrize("text", ["waive = 3", "waive = [3]", "[waive]\nrule = 1"])
def test_waivers_of_another_type_are_an_error(read, text):
    with pytest.raises(ConfigInvalid, match=", waive"):
        read(f"{text}\n")
