"""What a ``config.json`` of diffusers says, and which of it these networks can be."""

__all__ = ["AutoencoderOptions", "UNetOptions", "VectorOptions"]

from dataclasses import dataclass

from gsgen.reference_plugins.diffusion.model_config import ModelConfig

_DOWN = {"DownBlock2D": "", "AttnDownBlock2D": "image", "CrossAttnDownBlock2D": "context"}
_UP = {"UpBlock2D": "", "AttnUpBlock2D": "image", "CrossAttnUpBlock2D": "context"}
_MID = {"UNetMidBlock2D": "image", "UNetMidBlock2DCrossAttn": "context", None: None}
_UNCONDITIONAL, _CONDITIONAL = "UNet2DModel", "UNet2DConditionModel"
_TIME = 4

# Option → the values that make the network below; others would make another one.
_SAME = {
    "act_fn": ("silu",),
    "time_embedding_type": ("positional",),
    "class_embed_type": (None,),
    "num_class_embeds": (None,),
    "resnet_time_scale_shift": ("default", "scale_shift"),
    "downsample_type": ("conv",),
    "upsample_type": ("conv",),
    "encoder_hid_dim": (None,),
    "encoder_hid_dim_type": (None,),
    "time_cond_proj_dim": (None,),
    "time_embedding_act_fn": (None,),
    "timestep_post_act": (None,),
    "time_embedding_dim": (None,),
    "dual_cross_attention": (False,),
    "only_cross_attention": (False,),
    "mid_block_only_cross_attention": (None, False),
    "class_embeddings_concat": (False,),
    "resnet_skip_time_act": (False,),
    "resnet_out_scale_factor": (1, 1.0),
    "cross_attention_norm": (None,),
    "attention_type": ("default",),
    "attn_norm_num_groups": (None,),
    "reverse_transformer_layers_per_block": (None,),
}


@dataclass(frozen=True, slots=True)
class VectorOptions:
    """What is added to the embedded time, as in SDXL: of the prompt, and numbers about the image.

    Attributes:
        length: Of the vector: what the text encoder pools, and features of each number.
        features: Sines and cosines of one number.
    """

    length: int
    features: int

    @classmethod
    def of(cls, config: ModelConfig) -> "VectorOptions | None":
        """Return what a configuration says; None where nothing is added.

        Raises:
            CheckpointInvalid: Something of another kind is added.
        """
        if config.one_of("addition_embed_type", (None, "text_time")) is None:
            return None
        length = config.integer("projection_class_embeddings_input_dim", 0)
        features = config.integer("addition_time_embed_dim", 0)
        if features % 2 or features >= length:
            what = f"is {features}, wanted an even number below {length}"
            raise config.wrong("addition_time_embed_dim", what)
        return cls(length, features)


@dataclass(frozen=True, slots=True)
class UNetOptions:
    """The shape of a U-Net.

    Attributes:
        inputs: Channels of the image.
        outputs: Channels of the result.
        channels: Of each level, finest first.
        down: What follows the residual blocks of each level on the way down: nothing, attention
            between pixels (``image``), or a transformer (``context``).
        middle: The same of the middle; None where there is no middle.
        up: The same on the way up, coarsest first.
        layers: Residual blocks of each level.
        heads: Heads of attention of each level.
        depth: Transformer blocks of each level.
        context: Length of a conditioning vector; None without conditioning.
        groups: Of every norm.
        eps: Of norms of residual blocks.
        shrink: What sums of the middle are divided by.
        shifts: Time scales and shifts norms.
        linear: Transformers project by linear layers.
        padding: Of convolutions of stride 2.
        kernels: Sizes of the first and the last convolution.
        flip: Cosines of the time stand before its sines.
        shift: What is taken off the number of frequencies.
        centre: The image is brought from 0 … 1 to −1 … 1 first.
        attends: The middle has attention.
        sample: Height and width that training saw, if told.
        vector: What is added to the embedded time, if anything is.
    """

    inputs: int
    outputs: int
    channels: tuple[int, ...]
    down: tuple[str, ...]
    middle: str | None
    up: tuple[str, ...]
    layers: int
    heads: tuple[int, ...]
    depth: tuple[int, ...]
    context: int | None
    groups: int
    eps: float
    shrink: float
    shifts: bool
    linear: bool
    padding: int
    kernels: tuple[int, int]
    flip: bool
    shift: float
    centre: bool
    attends: bool
    sample: tuple[int, int] | None
    vector: VectorOptions | None

    @property
    def stride(self) -> int:
        """What sides of an image must be multiples of."""
        return int(2 ** (len(self.channels) - 1))

    @classmethod
    def of(cls, config: ModelConfig) -> "UNetOptions":
        """Return what a configuration says.

        Raises:
            CheckpointInvalid: It is no U-Net, or one of another kind.
        """
        kind = config.one_of("_class_name", (_UNCONDITIONAL, _CONDITIONAL))
        for name, values in _SAME.items():
            config.one_of(name, values, values[0])
        conditional = kind == _CONDITIONAL
        channels = config.integers("block_out_channels")
        levels = len(channels)
        down = config.kinds("down_block_types", _DOWN, levels)
        up = config.kinds("up_block_types", _UP, levels)
        usual = "UNetMidBlock2DCrossAttn" if conditional else "UNetMidBlock2D"
        middle = _MID[config.one_of("mid_block_type", tuple(_MID), usual)]
        context = config.integer("cross_attention_dim", 1280) if conditional else None
        if context is None and "context" in (*down, *up, middle):
            raise config.wrong(
                "down_block_types", "asks for conditioning, of which there is none"
            )
        return cls(
            inputs=config.integer("in_channels", 4 if conditional else 3),
            outputs=config.integer("out_channels", 4 if conditional else 3),
            channels=channels,
            down=down,
            middle=middle,
            up=up,
            layers=config.integer("layers_per_block", 2),
            heads=_heads(config, channels, conditional),
            depth=config.per_level("transformer_layers_per_block", levels, 1),
            context=context,
            groups=config.integer("norm_num_groups", 32),
            eps=config.number("norm_eps", 1e-5),
            shrink=config.number("mid_block_scale_factor", 1.0),
            shifts=config.values.get("resnet_time_scale_shift") == "scale_shift",
            linear=config.flag("use_linear_projection", False),
            padding=config.integer("downsample_padding", 1, least=0),
            kernels=(
                config.integer("conv_in_kernel", 3),
                config.integer("conv_out_kernel", 3),
            ),
            flip=config.flag("flip_sin_to_cos", True),
            shift=config.number("freq_shift", 0.0),
            centre=config.flag("center_input_sample", False),
            attends=config.flag("add_attention", True),
            sample=config.size("sample_size"),
            vector=VectorOptions.of(config) if conditional else None,
        )

    @property
    def time(self) -> int:
        """Length of the embedded time."""
        return _TIME * self.channels[0]


def _heads(
    config: ModelConfig, channels: tuple[int, ...], conditional: bool
) -> tuple[int, ...]:
    """Return the heads of each level.

    Of a conditional U-Net ``attention_head_dim`` is their number, in spite of its name.
    """
    levels = len(channels)
    if conditional:
        name = "num_attention_heads"
        if config.values.get(name) is None:
            name = "attention_head_dim"
        heads = config.per_level(name, levels, 8)
    elif config.values.get("attention_head_dim", 8) is None:
        heads = (1,) * levels
    else:
        width = config.integer("attention_head_dim", 8)
        heads = tuple(max(1, count // width) for count in channels)
    for count, head in zip(channels, heads, strict=True):
        if count % head:
            raise config.wrong(
                "attention_head_dim", f"{head} heads do not divide {count} channels"
            )
    return heads


@dataclass(frozen=True, slots=True)
class AutoencoderOptions:
    """The shape of an autoencoder (AutoencoderKL).

    Attributes:
        inputs: Channels of the image.
        outputs: Channels of the decoded image.
        latent: Channels between encoder and decoder.
        channels: Of each level, finest first.
        layers: Residual blocks of each level of the encoder; the decoder has one more.
        groups: Of every norm.
        scale: What a latent is multiplied by before the U-Net sees it.
        shift: What is taken off before.
        attends: The middle has attention.
        quantised: There are 1×1 convolutions before and behind the latent.
        skips: What enters each level of the encoder enters the decoder at that size, too, times
            this and through a 1×1 convolution (Difix); None where it does not.
    """

    inputs: int
    outputs: int
    latent: int
    channels: tuple[int, ...]
    layers: int
    groups: int
    scale: float
    shift: float
    attends: bool
    quantised: tuple[bool, bool]
    skips: float | None = None

    @property
    def stride(self) -> int:
        """Pixels of an image along one of its latent."""
        return int(2 ** (len(self.channels) - 1))

    @classmethod
    def of(cls, config: ModelConfig, *, skips: bool = False) -> "AutoencoderOptions":
        """Return what a configuration says.

        Args:
            config: The configuration.
            skips: There are weights for skip connections.

        Raises:
            CheckpointInvalid: It is no such autoencoder.
        """
        if skips:
            config.one_of("ignore_skip", (False,), False)
        config.one_of("_class_name", ("AutoencoderKL",))
        config.one_of("act_fn", ("silu",), "silu")
        config.one_of("latents_mean", (None,), None)
        config.one_of("latents_std", (None,), None)
        channels = config.integers("block_out_channels")
        config.kinds("down_block_types", {"DownEncoderBlock2D": ""}, len(channels))
        config.kinds("up_block_types", {"UpDecoderBlock2D": ""}, len(channels))
        shift = config.values.get("shift_factor")
        return cls(
            inputs=config.integer("in_channels", 3),
            outputs=config.integer("out_channels", 3),
            latent=config.integer("latent_channels", 4),
            channels=channels,
            layers=config.integer("layers_per_block", 1),
            groups=config.integer("norm_num_groups", 32),
            scale=config.number("scaling_factor", 0.18215),
            shift=0.0 if shift is None else config.number("shift_factor", 0.0),
            attends=config.flag("mid_block_add_attention", True),
            quantised=(
                config.flag("use_quant_conv", True),
                config.flag("use_post_quant_conv", True),
            ),
            skips=config.number("gamma", 1.0) if skips else None,
        )
