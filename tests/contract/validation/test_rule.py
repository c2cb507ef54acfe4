from types import ModuleType

import pytest

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRuns
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.gates import MODEL_RUNS
from gsgen.contract.validation.rule import Registry, rule, rules_in
from gsgen.contract.validation.waivers import Review
from support.reports.rules import made_up


def declared(id="GV999", name="always_so", doc="It is so.\n\nWhy:\n  x\n\nHint:\n  y", **options):
    def check(_: Rows):
        return iter(())

    check.__doc__, check.__name__ = doc, name
    return rule(id, Severity.ERROR, **options)(check)


def test_a_rule_takes_its_text_from_its_docstring():
    @rule("GV999", Severity.WARNING)
    def always_so(_: ModelOutputs):
        """It is so,
        whatever happens.

        Why:
            Because nothing else
            would do.

        Hint:
            Make it
            so.
        """

    assert always_so.statement == "It is so, whatever happens."
    assert always_so.rationale == "Because nothing else would do."
    assert always_so.hint == "Make it so."
    assert (always_so.id, always_so.slug, always_so.family) == ("GV999", "always-so", "GV")
    assert (always_so.scope, always_so.level) == ("emission", Level.VALUES)
    assert always_so.severity == Severity.WARNING
    assert always_so.kinds == ("gaussian-generator",)
    assert (always_so.needs, always_so.target, always_so.limit) == ((), "", "")
    assert always_so.evidence == ""


def test_rule_may_cite_an_observed_failure():
    doc = "It is so.\n\nWhy:\n  x\n\nHint:\n  y\n\nEvidence:\n  Seen\n  in a viewer.\n"
    declaration = declared(doc=doc)
    assert (declaration.hint, declaration.evidence) == ("y", "Seen in a viewer.")


@pytest.mark.parametrize(
    ("argument", "scope", "level"),
    [
        (InspectedModel, "model", Level.STATIC),
        (ProbeRuns, "execution", Level.VALUES),
        (ModelOutputs, "emission", Level.VALUES),
        (Rows, "rows", Level.VALUES),
        (DrawnSample, "sample", Level.VALUES),
        (Behaviour, "runs", Level.BEHAVIOUR),
        (Review, "report", Level.STATIC),
    ],
)
def test_type_of_the_argument_decides_scope_and_level(argument, scope, level):
    def check(_: argument):
        """Something holds.

        Why:
            Because.

        Hint:
            Make it so.
        """

    declaration = rule("GV999", Severity.ERROR)(check)
    assert (declaration.scope, declaration.level) == (scope, level)
    assert rule("GV999", Severity.ERROR, level=Level.LIVE)(check).level == Level.LIVE


def test_scope_of_a_context_is_given_by_name():
    assert declared(over="tileset").scope == "tileset"
    assert declared(over="live").level == Level.LIVE


@pytest.mark.parametrize("id", ["GV003", "acme/AC001", "acme-2/ZZ999"])
def test_an_id_is_two_letters_and_three_digits_with_a_name_in_front(id):
    assert declared(id).id == id


@pytest.mark.parametrize(
    "id", ["GV3", "gv003", "GV0033", "GVX003", "/GV003", "Acme/AC001", "3/AC001"]
)
def test_another_id_is_refused(id):
    with pytest.raises(ValueError, match="expected an id like GV003 and a name like opacity_range"):
        declared(id)


@pytest.mark.parametrize("name", ["<lambda>", "Opacity", "_opacity", "opacity__range"])
def test_another_name_is_refused(name):
    with pytest.raises(ValueError, match="expected an id like GV003 and a name like opacity_range"):
        declared(name=name)


@pytest.mark.parametrize(
    "doc",
    [
        None,
        "",
        "It is so.",
        "It is so.\n\nWhy:\n  x",
        "It is so.\n\nHint:\n  y",
        "It is so.\n\nHint:\n  y\n\nWhy:\n  x",
        "\nWhy:\n  x\n\nHint:\n  y",
        "It is so.\n\nWhy:\n\nHint:\n  y",
        "It is so.\n\nWhy:\n  x\n\nHint:\n",
    ],
)
def test_a_rule_without_sentence_reason_or_remedy_is_refused(doc):
    with pytest.raises(
        ValueError,
        match=r"^rule GV999: the docstring lacks a part, expected a statement, a `Why:` and",
    ):
        declared(doc=doc)


def test_a_module_has_the_rules_it_declares_in_order():
    module = ModuleType("acme")
    module.b, module.a, module.number = made_up("GV902"), made_up("GV901"), 3
    assert [entry.id for entry in rules_in(module)] == ["GV902", "GV901"]


def test_a_registry_has_every_id_once():
    with pytest.raises(ValueError, match="rule GV901 is declared twice"):
        Registry.from_rules([made_up("GV901"), made_up("GV901")])


def test_a_registry_has_all_that_its_rules_need():
    with pytest.raises(ValueError, match="rule GV901 needs GV900, which does not exist"):
        Registry.from_rules([made_up("GV901", needs=("GV900",))])


REGISTRY = Registry.from_rules(
    [declared("GV901", "opacity_range"), declared("acme/GV902", "rows_finite")]
)


@pytest.mark.parametrize(
    ("name", "id"),
    [
        ("GV901", "GV901"),
        ("gv901", "GV901"),
        ("opacity-range", "GV901"),
        ("Opacity-Range", "GV901"),
        ("ACME/gv902", "acme/GV902"),
    ],
)
def test_a_rule_is_found_by_id_or_name_in_any_case(name, id):
    assert REGISTRY.find(name).id == id


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("GV910", "Did you mean 'GV901'?"),
        ("opacity-rang", "Did you mean 'opacity-range'?"),
        ("zzz", "Known: opacity-range, rows-finite."),
        ("opacity-range2", "Did you mean 'opacity-range'?"),
        ("GV902", "Did you mean 'acme/GV902'?"),
        ("GX901", "Ids begin with GV, acme/GV; `gsgen rules` lists them."),
        ("acme/GV7", "Ids of acme/GV are acme/GV902 to acme/GV902; `gsgen rules` lists them."),
    ],
)
def test_an_unknown_rule_names_the_nearest_of_its_sort(name, hint):
    with pytest.raises(UnknownName) as caught:
        REGISTRY.find(name, "--ignore")
    assert str(caught.value) == f"--ignore: unknown rule {name!r}\n  {hint}"


ALL = Registry.from_rules(made_up(f"GV{number:03}") for number in (1, 2, 3, 12, 21, 30, 31))


@pytest.mark.parametrize(
    ("typed_id", "hint"),
    [
        *((typed_id, "Did you mean 'GV003'?") for typed_id in ("GV03", "gv3", "GV-003", "GV0003")),
        ("GV903", "Did you mean 'GV003'?"),
        ("GV013", "Did you mean 'GV003' or 'GV012' or 'GV031'?"),
        ("GV011", "Ids of GV are GV001 to GV031; `gsgen rules` lists them."),
        ("GV100", "Did you mean 'GV001'?"),
        ("GV0031000", "Ids of GV are GV001 to GV031; `gsgen rules` lists them."),
        ("GV777", "Ids of GV are GV001 to GV031; `gsgen rules` lists them."),
    ],
)
def test_only_ids_that_exist_are_suggested(typed_id, hint):
    with pytest.raises(UnknownName) as caught:
        ALL.find(typed_id)
    assert caught.value.hint == hint


def test_the_rules_of_runs_need_that_the_model_runs_and_static_rules_do_not():
    registry = Registry.from_rules(
        [made_up("GV901", over="rows"), made_up(MODEL_RUNS, over="execution"), made_up("GM901")]
    )
    assert registry.rules["GV901"].level > registry.rules["GM901"].level == Level.STATIC
    assert registry.with_needs(["GV901"]).rules.keys() == {"GV901", MODEL_RUNS}
    assert registry.with_needs(["GM901"]).rules.keys() == {"GM901"}
    assert registry.with_needs(["GV901", "GM901"]).rules.keys() == registry.rules.keys()
