"""Sizes of the network."""

from dataclasses import dataclass


@dataclass
class Options:
    input_size: int
    splat_size: int
    down_channels: tuple[int, ...]
    down_attention: tuple[bool, ...]
    up_channels: tuple[int, ...]
    up_attention: tuple[bool, ...]
    mid_attention: bool = True
    lambda_lpips: float = 1.0
