"""Small files of kinds that are no scenes, each with the words that an error must call it by."""

import pickle
import struct
import tarfile
import zipfile
from gzip import compress
from io import BytesIO

PLY_HEAD = (
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float f_dc_0\nend_header\n"
)


def zipped(**members: str | bytes) -> bytes:
    """A ZIP archive; ``__`` in a name is a slash, ``_DOT_`` a dot."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "/").replace("_DOT_", "."), content)
    return stream.getvalue()


def tar_gz() -> bytes:
    """A compressed tar archive of one text."""
    stream = BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        info = tarfile.TarInfo("readme.txt")
        info.size = 2
        archive.addfile(info, BytesIO(b"hi"))
    return stream.getvalue()


def safetensors() -> bytes:
    """Weights of one number."""
    header = b'{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}'
    return struct.pack("<Q", len(header)) + header + bytes(4)


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n"

# name of the file → content, words of the error
FOREIGN_FILES: dict[str, tuple[bytes, str]] = {
    "pointer.ply": (LFS, "git LFS pointer"),
    "pointer.onnx": (LFS, "git LFS pointer"),
    "pointer.json": (LFS, "git LFS pointer"),
    "pointer.glb": (LFS, "git LFS pointer"),
    "page.splat": (b"<!DOCTYPE html><html><title>Sign in</title></html>", "web page (HTML)"),
    "page.onnx": (b"\n<html><body>404</body></html>", "web page (HTML)"),
    "error.spz": (b'{"error": "Not Found", "status": 404}', "error message in JSON (Not Found)"),
    "denied.ply": (
        b'<?xml version="1.0"?><Error><Code>AccessDenied</Code><Message>no</Message></Error>',
        "error message of a server (AccessDenied)",
    ),
    "weights.safetensors": (safetensors(), "safetensors"),
    "tile.b3dm": (b"b3dm" + bytes(40), "b3dm"),
    "tile.i3dm": (b"i3dm" + bytes(40), "i3dm"),
    "tile.pnts": (b"pnts" + bytes(40), "pnts"),
    "tile.cmpt": (b"cmpt" + bytes(40), "cmpt"),
    "picture.png": (b"\x89PNG\r\n\x1a\n" + bytes(30), "PNG picture"),
    "picture.ply": (b"\xff\xd8\xff\xe0" + bytes(30), "JPEG picture"),
    "film.mp4": (b"\0\0\0\x20ftypisom" + bytes(30), "video"),
    "zeros.spz": (bytes(100), "zeros"),
    "transforms.json": (b'{"camera_angle_x": 0.6, "frames": []}', "file of cameras"),
    "model.fbx": (b"Kaydara FBX Binary  \0" + bytes(40), "FBX"),
    "stage.usdc": (b"PXR-USDC" + bytes(40), "USD"),
    "stage.usda": (b'#usda 1.0\ndef Xform "a" {}\n', "USD"),
    "stage.usdz": (zipped(a_DOT_usdc=b"PXR-USDC"), "USD archive"),
    "cloud.las": (b"LASF" + bytes(200), "LAS"),
    "cloud.e57": (b"ASTM-E57" + bytes(200), "E57"),
    "scene.rad": (b"RAD0" + bytes(40), "RAD"),
    "scene.lcc": (b'{"version": "5.0", "totalSplats": 5, "totalLevel": 2}', "LCC"),
    "notes.txt": (b"Hello world, these are notes.\n", "text that begins 'Hello world"),
    "docs.zip": (zipped(readme_DOT_txt="hi"), "ZIP archive of readme.txt"),
    "cut.zip": (zipped(a_DOT_ply=PLY_HEAD)[:60], "damaged or cut off ZIP archive"),
    "docs.tar.gz": (tar_gz(), "tar archive"),
    "notes.gz": (compress(b"Hello world, these are notes.\n"), "text that begins 'Hello world"),
    "old.pth": (pickle.dumps(0x1950A86A20F9469CFC6C, 2) + bytes(20), "torch before 1.6"),
    "data.pkl": (pickle.dumps({"a": 1}), "pickle"),
    "array.npy": (b"\x93NUMPY\x01\0" + bytes(50), "NumPy array"),
    "scene.7z": (b"7z\xbc\xaf'\x1c" + bytes(30), "7z archive"),
    "data.h5": (b"\x89HDF\r\n\x1a\n" + bytes(30), "HDF5"),
}
