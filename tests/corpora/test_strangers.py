"""Files of other projects get the committed verdicts, and none ends in a traceback."""

import pytest

from corpora.strangers import CORPORA, committed, corpus_folder, verdicts_of

# Tilesets that the validator of Cesium judges otherwise, and why.
OTHER_VERDICTS = {
    "tileTransformNonInvertible.json": "a transform that flattens places no splats",
    "tiles/i3dm/i3dmWithUri/tileset.json": "contents of version 1.0 hold no splats",
    "validTilesetWithValid3tz.json": "MAXAR_content_3tz is required, and not supported",
    "validTilesetWithValidB3dm.json": "contents of version 1.0 hold no splats",
    "validTilesetWithValidCmptWithGlbInfo.json": "contents of version 1.0 hold no splats",
    "validTilesetWithValidSchemaFromUri.json": "its schema is outside the tileset's folder",
}


@pytest.mark.parametrize("name", CORPORA)
def test_no_committed_verdict_is_a_traceback(name: str) -> None:
    verdicts = committed(name)
    assert verdicts
    assert [file for file, verdict in verdicts.items() if verdict.startswith("traceback")] == []


def test_verdicts_that_differ_from_cesiums_have_a_reason() -> None:
    verdicts = committed("3d-tiles-validator")
    other = {file for file, verdict in verdicts.items() if not verdict.endswith("agreed")}
    assert other == set(OTHER_VERDICTS)
    assert len(verdicts) - len(other) >= 134


@pytest.mark.nightly
@pytest.mark.parametrize("name", CORPORA)
def test_files_of_strangers_get_the_committed_verdicts(name: str) -> None:
    assert verdicts_of(name, corpus_folder(name)) == committed(name)
