"""Names of the extensions and codecs by which tilesets hold splats."""

__all__ = ["CONTENT_EXTENSION", "SPZ_EXTENSION", "CodecName"]

from typing import Final, Literal

CONTENT_EXTENSION: Final = "3DTILES_content_gltf"
"""The extension of ``tileset.json`` that names the glTF extensions of the contents."""

SPZ_EXTENSION: Final = "KHR_gaussian_splatting_compression_spz_2"
"""The glTF extension of contents that are compressed as SPZ."""

CodecName = Literal["spz", "khr"]
"""How contents store splats: SPZ, or float32 attributes of glTF."""
