"""Shaders that are whole, and shaders that are spliced into a function."""

import pytest

KERNEL = "runtime/gsgen/runtime/kernels/kernel.wgsl"
SNIPPET = "runtime/gsgen/runtime/kernels/snippet.wgsl"
WHOLE = """// Doubles every value { and this brace opens nothing.
override WORKGROUP: u32 = 64;
const ROW = 10u;
struct Frame {
    size: vec2u,
}
alias Row = array<f32, 10>;
@group(0) @binding(0) var<storage, read> values: array<f32>;
/* a block
   comment; */
fn double(x: f32) -> f32 { return 2.0 * x; }
//!include snippet
@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3u) {
    //!repeat PART PARTS
    let value_PART = double(values[id.x]);
    //!end
}
"""


def test_whole_shaders_pass(measure):
    files = {KERNEL: WHOLE, SNIPPET: "fn half(x: f32) -> f32 { return 0.5 * x; }\n"}
    assert measure("shaders", files).violations == []


@pytest.mark.parametrize(
    "text",
    [
        "let a = 1;\n",
        "// what it does\nsum = sum + 1;\n",
        "if (x) { y = 1; }\n",
        "{ let a = 1; }\n",
        "fn f() {\n",
        "fn f() { } }\n",
        "const A = 1",
        "size: vec2u,\n",
        "const A = 1;\nlet b = 2;\n",
    ],
)
def test_a_part_of_a_function_is_no_file(measure, text):
    result = measure("shaders", {SNIPPET: text})
    assert [violation.path for violation in result.violations] == [SNIPPET]
    assert not result.passed


@pytest.mark.parametrize("name", ["snippet", "shared/snippet", "snippet.wgsl"])
def test_a_whole_file_must_not_be_inserted_in_a_function(measure, name):
    spliced = f"fn f() {{\n    let a = 1;\n    //!include {name}\n}}\n"
    files = {KERNEL: spliced, SNIPPET: "const A = 1;\n"}
    (violation,) = measure("shaders", files).violations
    assert (violation.path, violation.line, violation.subject) == (
        KERNEL,
        3,
        name.removesuffix(".wgsl"),
    )
