"""Commands that draw and convert: render, view, bake, convert, references, bench-render."""
