from pathlib import Path
from typing import assert_type

from gsgen.contract import GsgenError, Report, Settings, load_target, validate
from gsgen.formats import PackedRows, PointCloud, Splats, open_splats, write_ply


def check(model: Path) -> bool:
    try:
        report = validate(model, Settings(target=load_target("webgpu")))
    except GsgenError as error:
        assert_type(error.hint, str)
        return False
    assert_type(report, Report)
    assert_type(report.verdict == "conforms", bool)
    for finding in report.findings:
        print(finding.rule.upper(), finding.message)
    return report.verdict == "conforms"


def copy(source: Path, target: Path) -> None:
    content = open_splats(source)
    assert_type(content, Splats | PointCloud | PackedRows)
    if isinstance(content, Splats):
        write_ply(target, content)
