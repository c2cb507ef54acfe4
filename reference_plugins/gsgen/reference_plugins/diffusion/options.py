"""Parses the ``config.json`` of diffusers into options of the networks that gsgen supports."""

__all__ = ["AutoencoderOptions", "UNetOptions", "VectorOptions"]

from dataclasses import dataclass

from gsgen.reference_plugins.diffusion.model_config import ModelConfig

_DOWN = {"DownBlock2D": "", "AttnDownBlock2D": "image", "CrossAttnDownBlock2D": "context"}
_UP = {"UpBlock2D": "", "AttnUpBlock2D": "image", "CrossAttnUpBlock2D": "context"}
_MID = {"UNetMidBlock2D": "image", "UNetMidBlock2DCrossAttn": "context", None: None}
_UNCONDITIONAL, _CONDITIONAL = "UNet2DModel", "UNet2DConditionModel"
_TIME = 4

# Option → its supported values, the default first.
_REQUIRED = {
    "act_fn": ("silu",),
    "time_embedding_type": ("positional",),
    "resnet_time_scale_shift": ("default", "scale_shift"),
    "downsample_type": ("conv",),
    "upsample_type": ("conv",),
    "mid_block_only_cross_attention": (None, False),
    "resnet_out_scale_factor": (1, 1.0),
    "attention_type": ("default",),
    **dict.fromkeys(
        (
            *("class_embed_type", "num_class_embeds", "encoder_hid_dim", "encoder_hid_dim_type"),
            *("time_cond_proj_dim", "time_embedding_act_fn", "timestep_post_act"),
            *("time_embedding_dim", "cross_attention_norm", "attn_norm_num_groups"),
            "reverse_transformer_layers_per_block",
        ),
        (None,),
    ),
    **dict.fromkeys(
        (
            *("dual_cross_attention", "only_cross_attention", "class_embeddings_concat"),
            "resnet_skip_time_act",
        ),
        (False,),
    ),
}


@dataclass(frozen=True, slots=True)
class VectorOptions:
    """Sizes of the vector of prompt and image sizes that SDXL adds to the timestep embedding."""

    length: int  # length of the vector: the pooled prompt, then features of each size
    features: int  # number of sines and cosines for one size

    @classmethod
    def of(cls, config: ModelConfig) -> "VectorOptions | None":
        """Parse the options of SDXL's conditioning vector; None if the network takes none."""
        if config.choice("addition_embed_type", (None, "text_time")) is None:
            return None
        length = config.integer("projection_class_embeddings_input_dim", 0)
        features = config.integer("addition_time_embed_dim", 0)
        if features % 2 or features >= length:
            problem = f"is {features}, expected an even number below {length}"
            raise config.option_error(problem, where="addition_time_embed_dim")
        return cls(length, features)


@dataclass(frozen=True, slots=True, kw_only=True)
class UNetOptions:
    """The layer sizes and options of a U-Net."""

    inputs: int  # channels of the image
    outputs: int  # channels of the result
    channels: tuple[int, ...]  # channels of each level, finest first
    # attention after the residual blocks of each level on the way down: empty for no attention,
    # ``image`` for self-attention, or ``context`` for a transformer
    down: tuple[str, ...]
    middle: str | None  # the same for the middle block; None without a middle block
    up: tuple[str, ...]  # the same on the way up, coarsest first
    layers: int  # residual blocks of each level
    heads: tuple[int, ...]  # heads of attention of each level
    depth: tuple[int, ...]  # transformer blocks of each level
    context: int | None  # length of a conditioning vector; None without conditioning
    groups: int  # groups of every norm
    eps: float  # epsilon of the norms of residual blocks
    shrink: float  # divisor of the sums in the middle block
    shifts: bool  # time scales and shifts norms
    linear: bool  # transformers project by linear layers
    padding: int  # padding of the convolutions of stride 2
    kernels: tuple[int, int]  # kernel sizes of the first and the last convolution
    flip: bool  # cosines of the time come before its sines
    shift: float  # number subtracted from the number of frequencies
    centre: bool  # the image is converted from 0 … 1 to −1 … 1 first
    attends: bool  # the middle block has attention
    sample: tuple[int, int] | None  # height and width of training samples, if known
    vector: VectorOptions | None  # options of the vector that is added to the embedded time, if any

    @property
    def stride(self) -> int:
        """The number that width and height of an image must be multiples of."""
        return int(2 ** (len(self.channels) - 1))

    @classmethod
    def of(cls, config: ModelConfig) -> "UNetOptions":
        """Parse the options of a U-Net from a ``config.json`` of diffusers."""
        kind = config.choice("_class_name", (_UNCONDITIONAL, _CONDITIONAL))
        for name, values in _REQUIRED.items():
            config.choice(name, values, values[0])
        conditional = kind == _CONDITIONAL
        channels = config.integers("block_out_channels")
        levels = len(channels)
        down = config.kinds("down_block_types", _DOWN, levels)
        up = config.kinds("up_block_types", _UP, levels)
        usual = "UNetMidBlock2DCrossAttn" if conditional else "UNetMidBlock2D"
        middle = _MID[config.choice("mid_block_type", tuple(_MID), usual)]
        context = config.integer("cross_attention_dim", 1280) if conditional else None
        if context is None and "context" in (*down, *up, middle):
            problem = "has blocks with cross-attention, but the network is unconditional"
            raise config.option_error(problem, where="down_block_types")
        return cls(
            inputs=config.integer("in_channels", 4 if conditional else 3),
            outputs=config.integer("out_channels", 4 if conditional else 3),
            channels=channels,
            down=down,
            middle=middle,
            up=up,
            layers=config.integer("layers_per_block", 2),
            heads=_heads_per_level(config, channels, conditional=conditional),
            depth=config.per_level("transformer_layers_per_block", levels, 1),
            context=context,
            groups=config.integer("norm_num_groups", 32),
            eps=config.number("norm_eps", 1e-5),
            shrink=config.number("mid_block_scale_factor", 1.0),
            shifts=config.values.get("resnet_time_scale_shift") == "scale_shift",
            linear=config.flag("use_linear_projection", default=False),
            padding=config.integer("downsample_padding", 1, least=0),
            kernels=(config.integer("conv_in_kernel", 3), config.integer("conv_out_kernel", 3)),
            flip=config.flag("flip_sin_to_cos", default=True),
            shift=config.number("freq_shift", 0.0),
            centre=config.flag("center_input_sample", default=False),
            attends=config.flag("add_attention", default=True),
            sample=config.size("sample_size"),
            vector=VectorOptions.of(config) if conditional else None,
        )

    @property
    def time(self) -> int:
        """The length of a U-Net's timestep embedding."""
        return _TIME * self.channels[0]


def _heads_per_level(
    config: ModelConfig, channels: tuple[int, ...], *, conditional: bool
) -> tuple[int, ...]:
    """Return the number of attention heads at each level of a U-Net.

    In conditional U-Nets, ``attention_head_dim`` is this number, in spite of its name.
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
            problem = f"{head} heads do not divide {count} channels"
            raise config.option_error(problem, where="attention_head_dim")
    return heads


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoencoderOptions:
    """The layer sizes and options of an image autoencoder (AutoencoderKL)."""

    inputs: int  # channels of the image
    outputs: int  # channels of the decoded image
    latent: int  # channels of the latent
    channels: tuple[int, ...]  # channels of each level, finest first
    layers: int  # residual blocks of each level of the encoder; the decoder has one more
    groups: int  # groups of every norm
    scale: float  # factor of the latent that the U-Net receives
    shift: float  # number subtracted from the latent before scaling
    attends: bool  # the middle block has attention
    # whether a 1×1 convolution precedes the latent, and whether one follows it
    quantised: tuple[bool, bool]
    # factor of the skip connections, which lead the input of each encoder level through a 1×1
    # convolution to the decoder (Difix); None without them
    skips: float | None = None

    @property
    def stride(self) -> int:
        """The number of image pixels along one latent pixel."""
        return int(2 ** (len(self.channels) - 1))

    @classmethod
    def of(cls, config: ModelConfig, *, skips: bool = False) -> "AutoencoderOptions":
        """Parse the options of an autoencoder from a ``config.json`` of diffusers."""
        if skips:
            config.choice("ignore_skip", (False,), False)
        config.choice("_class_name", ("AutoencoderKL",))
        config.choice("act_fn", ("silu",), "silu")
        config.choice("latents_mean", (None,), None)
        config.choice("latents_std", (None,), None)
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
            attends=config.flag("mid_block_add_attention", default=True),
            quantised=(
                config.flag("use_quant_conv", default=True),
                config.flag("use_post_quant_conv", default=True),
            ),
            skips=config.number("gamma", 1.0) if skips else None,
        )
