import dataclasses
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.contract.errors import ManifestInvalid, UnknownName
from gsgen.contract.spec.manifest import (
    CellsOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    PostProcessManifest,
    TrajectoryManifest,
    WeightedSum,
    manifest_type,
)
from gsgen.contract.spec.manifest_io import ManifestComplaint, dumps, loads, parse
from support.models.manifests import manifests

MINIMAL = {"contract": "1.0", "kind": "gaussian-generator", "name": "a", "outputs": {}}


def text(**changes):
    return json.dumps(MINIMAL | changes)


def complaint(document):
    parsed = parse(document)
    assert parsed.manifest is None
    assert len(parsed.complaints) == 1
    return parsed.complaints[0]


@settings(max_examples=40)
@given(manifests())
def test_a_manifest_survives_a_round_trip_through_text(manifest):
    assert loads(dumps(manifest)) == manifest
    assert loads(dumps(manifest, indent=None)) == manifest


@settings(max_examples=300)
@given(st.text() | st.tuples(st.integers(0, 150), st.integers(0, 9), st.text(max_size=3)))
def test_no_text_makes_the_reader_raise(document):
    if isinstance(document, tuple):  # a good one with something else in one place
        offset, removed, inserted = document
        good = text(bounds={"min": [0, 0, 0], "max": [1, 1, 1]}, blend="alpha")
        document = good[:offset] + inserted + good[offset + removed :]
    parsed = parse(document)
    assert (parsed.manifest is None) == bool(parsed.complaints)


def test_text_starts_with_kind_and_version():
    text = dumps(GeneratorManifest(name="ä", outputs=GeneratorOutputs()), indent=None)
    assert text.startswith(
        '{"contract": "1.0", "kind": "gaussian-generator", "inputs": [], "name": "ä"'
    )


def test_a_manifest_without_outputs_can_be_written_for_people_to_fill_in():
    assert json.loads(dumps(loads(text())))["outputs"] == {}


def test_an_input_without_axes_keeps_its_shape():
    scalar = Input(name="gain", role="control", shape=(), range=(0.0, 1.0), default=())
    generator_manifest = GeneratorManifest(name="a", inputs=(scalar,), outputs=GeneratorOutputs())
    assert loads(dumps(generator_manifest)).inputs == (scalar,)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"bounds": {"min": [0, 0], "max": [1, 1, 1]}},
            ManifestComplaint(
                "schema", "bounds.min", "[0, 0]", "Lower corner, x y z. (minItems 3)"
            ),
        ),
        (
            {"outputs": {"gaussians": {"name": "g"}}},
            ManifestComplaint(
                "schema", "outputs.gaussians", "no field 'capacity'", "'capacity' to be present"
            ),
        ),
        ({"blend": "add"}, ManifestComplaint("schema", "blend", '"add"', "one of alpha, wsr")),
        (
            {"space": {"upp": "-y", "x-a": 1}},
            ManifestComplaint(
                "schema",
                "space",
                "'upp'",
                "only the fields handedness, up, unit, matrix_order, origin, metres_per_unit",
            ),
        ),
        (
            {"name": ""},
            ManifestComplaint("schema", "name", '""', "What people call the model. (minLength 1)"),
        ),
        ({"inputs": [{"name": "t", "role": "clock"}]}, "inputs.0.role"),
        ({"kind": "generator"}, "kind"),
        ({"kind": ["gaussian-generator"]}, "kind"),
        ({"outputs": None}, "outputs"),
    ],
)
def test_complaint_states_location_actual_and_expected(changes, expected):
    actual = complaint(text(**changes))
    if isinstance(expected, str):
        assert (actual.cause, actual.where) == ("schema", expected)
    else:
        assert actual == expected


def test_complaints_come_in_order_of_their_place():
    inputs = [{"name": "t", "role": "time", "fps": -1}] * 11
    parsed = parse(text(inputs=inputs, blend="add"))
    assert [complaint.where for complaint in parsed.complaints] == [
        "blend",
        *(f"inputs.{index}.fps" for index in range(11)),
    ]


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ("", "a JSON document (Expecting value"),
        ("{", "a JSON document (Expecting property name"),
        ('{"contract": "1.0",}', "a JSON document ("),
        (text()[:-1] + ', "x-a": NaN}', "a JSON document (NaN is not a finite number)"),
        (text()[:-1] + ', "x-a": -Infinity}', "a JSON document (-Infinity is not a finite"),
        (text()[:-1] + ', "x-a": 1e999}', "a JSON document (1e999 is not a finite number)"),
        (text()[:-1] + f', "x-a": {10**400}}}', "a JSON document (1000000"),
        (text()[:-1] + ', "x-a": ' + "9" * 5000 + "}", "a JSON document (9999999"),
        (text(name="\ud800"), "a JSON document ('utf-8' codec can't encode"),
        ("[" * 100_000, "fewer brackets inside each other"),
    ],
)
def test_invalid_json_is_one_complaint_about_the_document(document, expected):
    actual = complaint(document)
    assert (actual.cause, actual.where) == ("syntax", "")
    assert actual.actual
    assert actual.expected.startswith(expected)


@pytest.mark.parametrize("depth", range(900, 1000, 3))
def test_no_depth_of_brackets_stops_the_reader(depth):
    assert parse(text()[:-1] + f', "inputs": {"[" * depth}{"]" * depth}}}').complaints


def test_a_text_of_many_megabytes_is_not_parsed():
    actual = complaint(" " * (1 + (4 << 20)))
    assert (actual.actual, actual.expected) == ("4194305 characters", "at most 4194304")


@pytest.mark.parametrize("document", ["[]", "3", '"text"', "null"])
def test_non_object_document_is_refused(document):
    assert complaint(document).expected == "a JSON object"


@pytest.mark.parametrize(
    "version", ["1", "1.0.0", "a.b", "", 1.0, None, "1.0\n", "١.٠", "1.123456"]
)
def test_invalid_version_is_refused(version):
    actual = complaint(text(contract=version))
    assert (actual.cause, actual.where) == ("version", "contract")
    assert actual.expected == 'a version such as "1.0"'


def test_a_manifest_without_a_version_is_refused():
    assert complaint('{"kind": "post-process"}').actual == "nothing"


@pytest.mark.parametrize(
    ("document", "actual", "reason"),
    [
        ('{"a": 1 "b": 2}', '{"a": 1 ^"b": 2}', "delimiter"),
        ('{\n"a": tru}', '{ "a": ^tru}', "value"),
        ('{"b": [' + "1, " * 99 + "]}", "1, 1, ^]}", "value"),
        ('\ufeff{"a": 1}', '{"a": 1}', "byte order mark"),
        ('{"a": 1}'.encode("utf-16").decode("latin-1"), "ÿþ{", "this is UTF-16"),
    ],
)
def test_a_syntax_error_shows_its_place(document, actual, reason):
    fault = complaint(document)
    assert actual in fault.actual
    assert reason in fault.expected


@pytest.mark.parametrize("value", ["true", "1.0", "null", ""])
def test_texts_keep_their_quotes(value):
    assert complaint(text(blend=value)).actual == json.dumps(value)


@pytest.mark.parametrize("version", ["2.0", "0.9", "17.3"])
def test_another_major_version_is_refused(version):
    parsed = parse(text(contract=version))
    expected = ManifestComplaint("version", "contract", version, "major version 1")
    assert parsed.complaints == (expected,)
    assert parsed.version == tuple(int(part) for part in version.split("."))


def test_a_newer_minor_version_is_read_with_fields_that_are_not_known():
    gaussians = {"name": "g", "capacity": 4, "packing": "dense"}
    parsed = parse(text(contract="1.7", outputs={"gaussians": gaussians}, mood="good"))
    assert parsed.is_newer_version
    assert parsed.version == (1, 7)
    assert parsed.manifest is not None
    assert parsed.manifest.outputs == GeneratorOutputs(GaussiansOutput("g", 4))


def test_a_newer_minor_version_must_still_get_the_known_fields_right():
    parsed = parse(text(contract="1.7", blend="add", mood="good"))
    assert [complaint.where for complaint in parsed.complaints] == ["blend"]


def test_extension_fields_are_accepted_everywhere():
    gaussians = {"name": "g", "capacity": 4, "x-acme": {"any": [1, None]}}
    parsed = parse(text(outputs={"gaussians": gaussians, "x-b": 1}, **{"x-c": "text"}))
    assert parsed.complaints == ()
    assert parsed.manifest is not None
    assert not parsed.is_newer_version


def test_writing_an_invalid_value_names_the_field():
    generator_manifest = GeneratorManifest(
        name="a", outputs=GeneratorOutputs(GaussiansOutput("g", 0))
    )
    with pytest.raises(ManifestInvalid) as caught:
        dumps(generator_manifest)
    assert str(caught.value) == (
        "manifest: outputs.gaussians.capacity: 0, expected "
        "Rows of the tensor, padding included. (minimum 1)"
    )


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_nonfinite_numbers_cannot_be_written(value):
    clock = Input(name="t", role="time", range=(0.0, value))
    generator_manifest = GeneratorManifest(name="a", inputs=(clock,), outputs=GeneratorOutputs())
    with pytest.raises(ManifestInvalid, match="is not a finite number"):
        dumps(generator_manifest)


def test_reading_a_wrong_text_lists_every_complaint():
    with pytest.raises(ManifestInvalid) as caught:
        loads(text(blend="add", antialias="none"))
    assert str(caught.value) == (
        'manifest: antialias: "none", expected one of classic, mip; '
        'blend: "add", expected one of alpha, wsr'
    )


def test_every_kind_has_a_type():
    types = {"gaussian-generator": GeneratorManifest, "post-process": PostProcessManifest}
    types |= {"trajectory-predictor": TrajectoryManifest}
    for kind, cls in types.items():
        assert manifest_type(kind) is cls
        defaults = {field.name: field.default for field in dataclasses.fields(cls)}
        assert defaults["kind"] == kind


def test_an_unknown_kind_names_the_nearest():
    with pytest.raises(UnknownName) as caught:
        manifest_type("gaussian-generater")
    assert str(caught.value) == (
        "unknown kind 'gaussian-generater'\n  Did you mean 'gaussian-generator'?"
    )


# ---- Cells -------------------------------------------------------------------------------------

SUMMED = {
    "blend": "wsr",
    "weighted_sum": {"background": 0.1, "depth_range": 12.5},
    "outputs": {"cells": {"name": "cells", "per_cell": 5}},
}


def test_cells_and_their_weights_are_read():
    document = loads(text(**SUMMED))
    assert document.outputs.cells == CellsOutput("cells", 5, "float32")
    assert document.weighted_sum == WeightedSum(0.1, 12.5, 1.0)
    assert loads(dumps(document)) == document
    open_ended = loads(text(weighted_sum={"background": 0}))
    assert open_ended.weighted_sum.depth_range is None


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"outputs": {"cells": {"name": "c"}}}, "outputs.cells"),
        ({"outputs": {"cells": {"name": "c", "per_cell": 0}}}, "outputs.cells.per_cell"),
        (
            {"outputs": {"cells": {"name": "c", "per_cell": 2, "dtype": "int8"}}},
            "outputs.cells.dtype",
        ),
        ({"weighted_sum": {}}, "weighted_sum"),
        ({"weighted_sum": {"background": -0.1}}, "weighted_sum.background"),
        ({"weighted_sum": {"background": 0, "depth_range": 0}}, "weighted_sum.depth_range"),
        ({"weighted_sum": {"background": 0, "depth_range": None}}, "weighted_sum.depth_range"),
        ({"weighted_sum": {"background": 0, "opacity_divisor": 0}}, "weighted_sum.opacity_divisor"),
    ],
)
def test_invalid_cells_and_weights_are_refused(changes, where):
    actual = complaint(text(**changes))
    assert (actual.cause, actual.where) == ("schema", where)
