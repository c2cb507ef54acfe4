"""Decodes anchors by networks, in tensors whose shapes do not depend on the camera.

The published code selects anchors in view and Gaussians of positive opacity, so that its shapes
depend on the camera. Here every anchor is decoded, and those not selected get
opacity zero.
"""

__all__ = ["AnchorHeads", "AnchorViews", "DecodedAnchors"]

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud, AnchorNets, Mlp
from gsgen.reference_plugins.tensors.layers import Dense

_COVARIANCE_CHANNELS = 7


@dataclass(frozen=True, slots=True)
class DecodedAnchors:
    """The attributes that networks decoded for N anchors with K Gaussians each."""

    # tanh of the opacity head, [N, K]; Gaussians of at most 0 are invisible
    opacity: Float[Tensor, "n k"]
    scale: tuple[Tensor, ...]  # three factors of the anchor's scale before the sigmoid, [N, K] each
    rotation: tuple[Tensor, ...]  # w, x, y, z, not normalised, [N, K] each
    color: Float[Tensor, "m 3"]  # RGB before the sigmoid, [N K, 3]


@dataclass(frozen=True, slots=True)
class AnchorViews:
    """Direction and distance of N anchors from the camera, and the appearance embedding's index."""

    direction: Float[Tensor, "n 3"]  # unit vectors from the camera, [N, 3]
    distance: Float[Tensor, "n 1"]  # distances from the camera, [N, 1]
    appearance_id: Int[Tensor, "1"] | None = None  # number of the appearance, if there are several


class _Layers(nn.Module):
    """Two dense layers with ReLU between them; the outputs are split into equal parts.

    Each part is a product of its own, because columns of one wide product would need copies.
    """

    def __init__(self, hidden: Tensor, mlp: Mlp, per_anchor: int, parts: int = 1) -> None:
        super().__init__()
        self.hidden = Dense(hidden, mlp.hidden_bias)
        columns = mlp.out.shape[0] // (per_anchor * parts)
        shaped_weight = mlp.out.reshape(per_anchor, parts, columns, -1)
        biases = mlp.out_bias.reshape(per_anchor, parts, columns)
        self.output_layers = nn.ModuleList(
            Dense(shaped_weight[:, part].flatten(0, 1), biases[:, part].flatten())
            for part in range(parts)
        )

    def forward(self, inputs: Tensor, bias: Tensor | None = None) -> list[Tensor]:
        """Apply two dense layers; a given bias replaces that of the first layer."""
        first = self.hidden
        hidden = torch.relu(first(inputs) if bias is None else inputs @ first.weight + bias)
        return [out(hidden) for out in self.output_layers]


class AnchorHeads(nn.Module):
    """Decodes anchor features to Gaussians for the direction and the distance of the camera.

    The published networks concatenate feature, direction, (distance), (level), (appearance). Here
    all heads share one tensor of the first four; a head without one of these inputs has zeros in
    its weight. The appearance is the same for all anchors, so its product with the weight is
    computed beforehand: one row of bias for each training camera.
    """

    feature: Tensor
    level: Tensor | None
    appearance_bias: Tensor | None

    def __init__(self, cloud: AnchorCloud, nets: AnchorNets, appearance: int | None = None) -> None:
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.width = cloud.width
        heads = (nets.opacity, nets.covariance, nets.color)
        self.distance = any(head.distance for head in heads)
        self.bank_uses_distance = nets.feature_bank is not None and nets.feature_bank.distance
        self.register_buffer("feature", cloud.feature)
        level = cloud.level[:, None] if nets.level and cloud.level is not None else None
        self.register_buffer("level", level)
        self.opacity = self._make_layers(nets.opacity)
        self.covariance = self._make_layers(nets.covariance, _COVARIANCE_CHANNELS)
        self.color = self._make_layers(nets.color)
        feature_bank = nets.feature_bank
        self.feature_bank = (
            _Layers(feature_bank.hidden, feature_bank, 1) if feature_bank is not None else None
        )
        self.register_buffer("appearance_bias", self._appearance_bias(nets, appearance))

    @property
    def appearances(self) -> int:
        """The number of appearance embeddings to choose from; 0 if there is at most one."""
        appearance_bias = self.appearance_bias
        if appearance_bias is None or appearance_bias.shape[0] == 1:
            return 0
        return int(appearance_bias.shape[0])

    def _make_layers(self, mlp: Mlp, parts: int = 1) -> _Layers:
        hidden = [mlp.hidden[:, : self.width + 3]]
        start = self.width + 3
        if self.distance:
            column = mlp.hidden[:, start : start + 1] if mlp.distance else 0 * mlp.hidden[:, :1]
            hidden.append(column)
        start += mlp.distance
        if self.level is not None:
            hidden.append(mlp.hidden[:, start : start + 1])
        return _Layers(torch.cat(hidden, dim=1), mlp, self.per_anchor, parts)

    def _appearance_bias(self, nets: AnchorNets, appearance: int | None) -> Tensor | None:
        """Return the colour network's first-layer bias for each appearance embedding; None without one."""
        if nets.embedding is None:
            return None
        rows = nets.embedding if appearance is None else nets.embedding[appearance][None]
        weight = nets.color.hidden[:, -nets.embedding.shape[1] :]
        return rows @ weight.t() + nets.color.hidden_bias

    def forward(self, views: AnchorViews, rows: Int[Tensor, " n"] | None = None) -> DecodedAnchors:
        """Decode the features of anchors for one camera."""
        feature = self.feature
        levels = [] if self.level is None else [self.level]
        if rows is not None:
            feature = torch.index_select(feature, 0, rows)
            levels = [torch.index_select(level, 0, rows) for level in levels]
        parts = [self._mix_feature_banks(feature, levels, views), views.direction]
        parts += [views.distance] if self.distance else []
        inputs = torch.cat([*parts, *levels], dim=1)
        appearance_bias = self.appearance_bias
        if appearance_bias is not None and views.appearance_id is not None:
            appearance_bias = torch.index_select(appearance_bias, 0, views.appearance_id)
        (opacity,) = self.opacity(inputs)
        planes = tuple(self.covariance(inputs))
        (color,) = self.color(inputs, appearance_bias)
        return DecodedAnchors(torch.tanh(opacity), planes[:3], planes[3:], color.reshape(-1, 3))

    def _mix_feature_banks(
        self, feature: Tensor, levels: list[Tensor], views: AnchorViews
    ) -> Tensor:
        """Mix three resolutions of a feature vector: every fourth number, every second, all.

        The coarse ones are repeated (a b a b), not stretched (a a b b).
        """
        if self.feature_bank is None:
            return feature
        extra_inputs = [views.distance] if self.bank_uses_distance else levels
        (weight,) = self.feature_bank(torch.cat([views.direction, *extra_inputs], dim=1))
        bank_blend_weights = torch.softmax(weight, dim=1)
        mixed_feature = feature[:, ::4].repeat(1, 4) * bank_blend_weights[:, 0:1]
        mixed_feature = mixed_feature + feature[:, ::2].repeat(1, 2) * bank_blend_weights[:, 1:2]
        return mixed_feature + feature * bank_blend_weights[:, 2:3]
