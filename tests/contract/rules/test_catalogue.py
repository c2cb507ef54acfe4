import sys
from importlib.metadata import EntryPoint
from types import ModuleType

import pytest

from gsgen.contract.errors import UnknownName
from gsgen.contract.rules import catalogue as installed
from gsgen.contract.rules.catalogue import builtin_rules, installed_rules
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from support.reports.rules import made_up

FAMILIES = ["GM", "GI", "GO", "GG", "GV", "GB", "GL", "GS", "TV", "GW"]


def test_the_catalogue_goes_family_by_family_in_order_of_ids():
    rules = builtin_rules()
    assert len(rules) > 50
    order = [(FAMILIES.index(rule.family), rule.id) for rule in rules]
    assert order == sorted(order)


@pytest.mark.parametrize(
    ("id", "remedy"),
    [("GB009", 'count_semantics = "upper-bound"'), ("TV103", "gsgen.sdk.math.camera_centre(view)")],
)
def test_a_hint_names_what_a_module_of_the_sdk_writes(id: str, remedy: str):
    rule = next(rule for rule in builtin_rules() if rule.id == id)
    assert remedy in rule.hint


def test_every_rule_has_an_id_and_a_name_of_its_own():
    rules = builtin_rules()
    assert len({rule.id for rule in rules}) == len(rules)
    assert len({rule.slug for rule in rules}) == len(rules)
    assert Registry.from_rules(rules)


def test_every_rule_names_each_rule_that_it_needs_once():
    for rule in builtin_rules():
        assert len(set(rule.needs)) == len(rule.needs), rule.id


def test_each_rule_comes_with_all_that_it_needs():
    registry = installed_rules()
    for rule in registry.rules.values():
        part = registry.with_needs([rule.id]).rules
        assert rule.id in part
        assert all(needed_rule in part for entry in part.values() for needed_rule in entry.needs)


def test_every_rule_applies_to_a_kind_and_its_first_sentence_is_one():
    for rule in builtin_rules():
        assert rule.kinds
        assert set(rule.kinds) <= set(MANIFEST_KINDS)
        assert rule.statement.endswith("."), rule.id


@pytest.fixture
def plugin(monkeypatch):
    """Register a module, made here, as a third party's rules."""
    points = []

    def register(name, module=None, **content):
        point = EntryPoint(name, module or f"acme_{len(points)}", "gsgen.rules")
        if module is None:
            plugin_module = ModuleType(point.value)
            vars(plugin_module).update(content)
            monkeypatch.setitem(sys.modules, point.value, plugin_module)
        points.append(point)

    monkeypatch.setattr(installed, "registered_entry_points", lambda group: points)
    installed_rules.cache_clear()
    yield register
    installed_rules.cache_clear()


def foreign():
    own_ids = {rule.id for rule in builtin_rules()}
    return [rule for rule in installed_rules().rules.values() if rule.id not in own_ids]


def test_without_plugins_our_own_rules_are_all(plugin):
    assert foreign() == []
    assert installed_rules() is installed_rules()


def test_a_plugins_module_brings_its_rules(plugin):
    plugin("acme", rule=made_up("acme/AC001"), other=3)
    assert [rule.id for rule in foreign()] == ["acme/AC001"]


def test_a_plugin_may_name_a_list_of_rules(plugin, monkeypatch):
    monkeypatch.setattr(EntryPoint, "load", lambda self: (made_up("acme/AC001"),))
    plugin("acme", "acme:RULES")
    assert [rule.id for rule in foreign()] == ["acme/AC001"]


@pytest.mark.parametrize(
    ("name", "id"),
    [
        ("acme", "acme/XX000"),
        ("Acme_Rules 2", "acme-rules-2/XX000"),
        ("2acme", "acme/XX000"),
        ("規則", "plugin/XX000"),
    ],
)
def test_a_plugin_that_does_not_load_is_a_rule_that_crashes(plugin, name, id):
    plugin(name, "absent_module_of_acme")
    (rule,) = foreign()
    assert rule.id == id
    assert rule.kinds == MANIFEST_KINDS
    board = ResultCollector(registry=installed_rules(), settings=Settings(), kind="")
    assert board.is_ready(rule)
    assert not board.check(rule, None)
    reason = board.outcomes[rule.id].reason.splitlines()[-1]
    assert reason == (
        f"ImportError: rules {name} = absent_module_of_acme do not load: "
        "ModuleNotFoundError(\"No module named 'absent_module_of_acme'\")"
    )


@pytest.mark.parametrize(
    ("text", "location"),
    [
        ("from gsgen.contract.rules import absent\n", "faulty_acme.py:1 (from gsgen"),
        (
            "from gsgen.contract.rule import Severity, rule\n\n"
            "@rule('acme/AC001', Severity.ERROR)\n"
            "def check(model: str):\n    'One. Why: two.'\n",
            "acme/AC001: model: str is the argument, expected one of InspectedModel, ",
        ),
    ],
)
def test_a_fault_in_a_plugin_s_module_names_its_line(plugin, tmp_path, monkeypatch, text, location):
    (tmp_path / "faulty_acme.py").write_text(text, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "faulty_acme", raising=False)
    plugin("acme", "faulty_acme")
    (rule,) = foreign()
    with pytest.raises(ImportError) as raised:
        list(rule.check(None))
    assert location in str(raised.value)
    assert "faulty_acme.py:" in str(raised.value)
    with pytest.raises(UnknownName, match="rules of 'acme' do not load"):
        installed_rules().find("acme/AC001")


def test_two_plugins_that_do_not_load_are_two_rules(plugin):
    plugin("acme", "absent_module_of_acme")
    plugin("acme", "another_absent_module")
    assert [rule.id for rule in foreign()] == ["acme/XX000", "acme/XX001"]


def test_a_plugin_cannot_take_the_place_of_a_rule(plugin):
    plugin("acme", rule=made_up("GV003"))
    (rule,) = foreign()
    assert rule.id == "acme/XX000"
    with pytest.raises(ImportError, match="rule GV003 is declared twice"):
        list(rule.check(None))


def test_an_id_without_a_name_in_front_is_gsgen_s_own(plugin):
    plugin("acme", rule=made_up("AC001"))
    (rule,) = foreign()
    with pytest.raises(ImportError, match="AC001 has no name in front, expected acme/AC001"):
        list(rule.check(None))


def test_a_plugin_that_names_something_else_is_a_rule_that_crashes(plugin, monkeypatch):
    monkeypatch.setattr(EntryPoint, "load", lambda self: [3])
    plugin("acme", "acme:RULES")
    assert [rule.id for rule in foreign()] == ["acme/XX000"]
