"""Commands that scripts call print JSON that agrees with what people read."""

import json
from pathlib import Path

from support.commands import gsgen_here


def test_explain_prints_the_entries_of_rules() -> None:
    explanation = json.loads(gsgen_here("explain", "GV003", "rows-finite", "--json").out)
    listed = {rule["id"]: rule for rule in json.loads(gsgen_here("rules", "--json").out)}
    assert explanation == [listed["GV003"], listed["GV001"]]


def test_new_prints_the_files_that_it_wrote(tmp_path: Path) -> None:
    result = gsgen_here("new", "my-method", "--into", tmp_path, "--json")
    assert result.code == 0, result.err
    document = json.loads(result.out)
    written = {str(path) for path in Path(document["folder"]).rglob("*") if path.is_file()}
    assert set(document["files"]) == written
