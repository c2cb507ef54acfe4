"""Checks the ``config.json`` of diffusers: which networks are supported, and what they take."""

__all__ = ["AutoencoderOptions", "UNetOptions", "VectorOptions"]

from dataclasses import dataclass

from gsgen.reference_plugins.diffusion.model_config import ModelConfig

_DOWN_BLOCKS = {"DownBlock2D": "", "AttnDownBlock2D": "image", "CrossAttnDownBlock2D": "context"}
_UP_BLOCKS = {"UpBlock2D": "", "AttnUpBlock2D": "image", "CrossAttnUpBlock2D": "context"}
_MID_BLOCKS = {"UNetMidBlock2D": "image", "UNetMidBlock2DCrossAttn": "context", None: None}
_UNCONDITIONAL_CLASS, _CONDITIONAL_CLASS = "UNet2DModel", "UNet2DConditionModel"

# Option → its supported values, the default first.
_REQUIRED_SETTINGS = {
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
    """What a U-Net takes and returns, and how its layers are counted."""

    inputs: int  # channels of the image
    outputs: int  # channels of the result
    channels: tuple[int, ...]  # channels of each level, finest first
    up: tuple[str, ...]  # attention of each level on the way up, coarsest first: empty for none
    layers: int  # residual blocks of each level
    context: int | None  # length of a conditioning vector; None without conditioning
    groups: int  # groups of every norm
    flip: bool  # cosines of the time come before its sines
    shift: float  # number subtracted from the number of frequencies
    sample: tuple[int, int] | None  # height and width of training samples, if known
    vector: VectorOptions | None  # options of the vector that is added to the embedded time, if any

    @property
    def stride(self) -> int:
        """The number that width and height of an image must be multiples of."""
        return int(2 ** (len(self.channels) - 1))

    @classmethod
    def of(cls, config: ModelConfig) -> "UNetOptions":
        """Parse the options of a U-Net from a ``config.json`` of diffusers."""
        kind = config.choice("_class_name", (_UNCONDITIONAL_CLASS, _CONDITIONAL_CLASS))
        for name, values in _REQUIRED_SETTINGS.items():
            config.choice(name, values, values[0])
        is_conditional = kind == _CONDITIONAL_CLASS
        channels = config.integers("block_out_channels")
        levels = len(channels)
        down_block_types = config.kinds("down_block_types", _DOWN_BLOCKS, levels)
        up = config.kinds("up_block_types", _UP_BLOCKS, levels)
        default_class = "UNetMidBlock2DCrossAttn" if is_conditional else "UNetMidBlock2D"
        middle = _MID_BLOCKS[config.choice("mid_block_type", tuple(_MID_BLOCKS), default_class)]
        context = config.integer("cross_attention_dim", 1280) if is_conditional else None
        if context is None and "context" in (*down_block_types, *up, middle):
            problem = "has blocks with cross-attention, but the network is unconditional"
            raise config.option_error(problem, where="down_block_types")
        return cls(
            inputs=config.integer("in_channels", 4 if is_conditional else 3),
            outputs=config.integer("out_channels", 4 if is_conditional else 3),
            channels=channels,
            up=up,
            layers=config.integer("layers_per_block", 2),
            context=context,
            groups=config.integer("norm_num_groups", 32),
            flip=config.flag("flip_sin_to_cos", default=True),
            shift=config.number("freq_shift", 0.0),
            sample=config.size("sample_size"),
            vector=VectorOptions.of(config) if is_conditional else None,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoencoderOptions:
    """What an image autoencoder (AutoencoderKL) takes and returns."""

    inputs: int  # channels of the image
    outputs: int  # channels of the decoded image
    latent: int  # channels of the latent
    channels: tuple[int, ...]  # channels of each level, finest first
    scale: float  # factor of the latent that the U-Net receives
    shift: float  # number subtracted from the latent before scaling
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
            scale=config.number("scaling_factor", 0.18215),
            shift=0.0 if shift is None else config.number("shift_factor", 0.0),
            skips=config.number("gamma", 1.0) if skips else None,
        )
