"""Kinds of files that a few bytes at a fixed offset identify."""

__all__ = ["kind_by_signature"]

from typing import Final

from gsgen.contract.file_kinds.kind import (
    DOWNLOAD_AGAIN_HINT,
    EXPORT_SPLATS_HINT,
    MODEL,
    SPLATS,
    UNPACK,
    FileKind,
)

_OLD_TILES_HINT = (
    "Upgrade its tileset to 3D Tiles 1.1, whose contents are GLB: `3d-tiles-tools upgrade`."
)
_POINTS = "A point cloud: convert it to a PLY with x, y, z and colours."
_PICTURE = "A picture cannot be opened as a scene: name the splats, mesh or model that it shows."
_RESAVE_HINT = "Load it with torch, and save it again: `torch.save(torch.load(OLD), NEW)`."
_PICKLE_HINT = (
    "Only checkpoints of `torch.save` are read: save the tensors with torch 1.6 or later."
)
_ORT_HINT = "Name the ONNX model that it was converted from; an ORT file cannot be turned back."
_SAVE_TENSORS_HINT = "Save the tensors as a 3DGS PLY, or in a checkpoint of gsplat."

# Offset and bytes → name, title, hint; the first match counts.
_FILE_SIGNATURES: Final[tuple[tuple[int, bytes, str, str, str], ...]] = (
    (0, b"b3dm", "b3dm", "a tile of 3D Tiles 1.0 with a mesh (b3dm)", _OLD_TILES_HINT),
    (0, b"i3dm", "i3dm", "a tile of 3D Tiles 1.0 with instances (i3dm)", _OLD_TILES_HINT),
    (0, b"pnts", "pnts", "a tile of 3D Tiles 1.0 with points (pnts)", _OLD_TILES_HINT),
    (0, b"cmpt", "cmpt", "a composite tile of 3D Tiles 1.0 (cmpt)", _OLD_TILES_HINT),
    (0, b"subt", "subtree", "a subtree of an implicit tileset", "Name its tileset.json."),
    (0, b"Kaydara FBX Binary", "fbx", "an FBX file", EXPORT_SPLATS_HINT),
    (0, b"PXR-USDC", "usd", "a USD file (binary, usdc)", EXPORT_SPLATS_HINT),
    (0, b"#usda", "usd", "a USD file (text, usda)", EXPORT_SPLATS_HINT),
    (0, b"RAD0", "rad", "a RAD file of splats (Spark)", EXPORT_SPLATS_HINT),
    (0, b"RADC", "rad", "a chunk of a RAD file of splats (Spark)", EXPORT_SPLATS_HINT),
    (0, b"LASF", "las", "a point cloud in LAS or LAZ", _POINTS),
    (0, b"ASTM-E57", "e57", "a point cloud in E57", _POINTS),
    (0, b"# .PCD", "pcd", "a point cloud in PCD", _POINTS),
    (0, b"DRACO", "draco", "a mesh or point cloud in Draco", EXPORT_SPLATS_HINT),
    (0, b"BLENDER", "blend", "a Blender file", EXPORT_SPLATS_HINT),
    (0, b"Ogawa", "alembic", "an Alembic file", EXPORT_SPLATS_HINT),
    (0, b"\x89PNG", "picture", "a PNG picture", _PICTURE),
    (0, b"\xff\xd8\xff", "picture", "a JPEG picture", _PICTURE),
    (0, b"GIF8", "picture", "a GIF picture", _PICTURE),
    (0, b"II*\0", "picture", "a TIFF picture", _PICTURE),
    (0, b"MM\0*", "picture", "a TIFF picture", _PICTURE),
    (0, b"v/1\x01", "picture", "an OpenEXR picture", _PICTURE),
    (0, b"#?RADIANCE", "picture", "an HDR picture", _PICTURE),
    (0, b"8BPS", "picture", "a Photoshop picture", _PICTURE),
    (0, b"DDS ", "picture", "a DDS texture", _PICTURE),
    (0, b"\xabKTX ", "picture", "a KTX texture", _PICTURE),
    (8, b"WEBP", "picture", "a WebP picture", _PICTURE),
    (8, b"AVI ", "video", "an AVI video", _PICTURE),
    (8, b"WAVE", "audio", "a sound file (WAV)", ""),
    (4, b"ftypheic", "picture", "a HEIC picture", _PICTURE),
    (4, b"ftypmif1", "picture", "a HEIF picture", _PICTURE),
    (4, b"ftypavif", "picture", "an AVIF picture", _PICTURE),
    (4, b"ftyp", "video", "an MP4 or QuickTime video", _PICTURE),
    (4, b"moov", "video", "a QuickTime video", _PICTURE),
    (0, b"\x1aE\xdf\xa3", "video", "a Matroska or WebM video", _PICTURE),
    (0, b"7z\xbc\xaf'\x1c", "archive", "a 7z archive", UNPACK),
    (0, b"Rar!\x1a\x07", "archive", "a RAR archive", UNPACK),
    (0, b"BZh", "archive", "a bzip2 file", UNPACK),
    (0, b"\xfd7zXZ\0", "archive", "an xz file", UNPACK),
    (0, b"(\xb5/\xfd", "archive", "a Zstandard file", UNPACK),
    (257, b"ustar", "archive", "a tar archive", UNPACK),
    (0, b"PK\x05\x06", "zip", "an empty ZIP archive", DOWNLOAD_AGAIN_HINT),
    (0, b"\x93NUMPY", "npy", "a NumPy array", "Save named arrays with `np.savez`."),
    (0, b"\x89HDF", "hdf5", "an HDF5 file", _SAVE_TENSORS_HINT),
    (0, b"GGUF", "gguf", "a file of weights (GGUF)", _SAVE_TENSORS_HINT),
    (0, b"PAR1", "parquet", "a Parquet table", ""),
    (0, b"SQLite format 3", "sqlite", "an SQLite database, such as COLMAP's", ""),
    (0, b"%PDF", "pdf", "a PDF document", ""),
    (0, b"\x7fELF", "program", "a program or library", ""),
    (4, b"ORTM", "ort", "a model in ONNX Runtime's own format (ORT)", _ORT_HINT),
    (4, b"TFL3", "tflite", "a TensorFlow Lite model", "Convert it to ONNX."),
    (0, b"NGSP", "spz", "an SPZ file of splats", SPLATS),
    (0, b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.", "old-torch", "a checkpoint of torch before 1.6", _RESAVE_HINT),
    (0, b"\x80\x02", "pickle", "a pickle", _PICKLE_HINT),
    (0, b"\x80\x03", "pickle", "a pickle", _PICKLE_HINT),
    (0, b"\x80\x04", "pickle", "a pickle", _PICKLE_HINT),
    (0, b"\x80\x05", "pickle", "a pickle", _PICKLE_HINT),
)  # fmt: skip

# Tags of the fields of an ONNX ModelProto that may follow its IR version.
_MODEL_TAGS: Final = b"\x12\x1a\x22\x2a\x32\x3a\x42\x72"


def kind_by_signature(head: bytes) -> FileKind | None:
    """Return the kind of file that certain first bytes identify; None if none does."""
    for offset, signature, name, title, hint in _FILE_SIGNATURES:
        if head[offset : offset + len(signature)] == signature:
            return FileKind(name=name, title=title, hint=hint)
    # A length in 8 bytes, and a JSON object of at most 100 MB.
    if head[8:9] == b"{" and 0 < int.from_bytes(head[:8], "little") < 10**8:
        return FileKind(
            name="safetensors", title="a file of weights (safetensors)", hint=_SAVE_TENSORS_HINT
        )
    is_model_version = head[:1] == b"\x08" and b"\0" < head[1:2] < b"\x40"
    if len(head) > 3 and is_model_version and head[2:3] in _MODEL_TAGS:
        return FileKind(name="onnx", title="an ONNX model", hint=MODEL)
    return None
