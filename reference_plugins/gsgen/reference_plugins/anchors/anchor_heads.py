"""The networks of anchor methods, in a form of constant shape.

The published code selects anchors in view and Gaussians of positive opacity, so that its shapes
depend on the camera. Here every anchor is decoded; what would not have been selected gets
opacity zero.
"""

__all__ = ["AnchorHeads", "Asked", "Decoded"]

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCloud, AnchorNets, Mlp
from gsgen.reference_plugins.tensors.layers import Dense

_COVARIANCE = 7


@dataclass(frozen=True, slots=True)
class Decoded:
    """What the networks say of N anchors with K Gaussians each.

    Attributes:
        opacity: tanh of the first head, [N, K]; of those at most 0 there is nothing to see.
        scale: Three factors of the anchor's scale before the sigmoid, [N, K] each.
        rotation: w, x, y, z, not normalised, [N, K] each.
        color: RGB before the sigmoid, [N K, 3].
    """

    opacity: Float[Tensor, "n k"]
    scale: tuple[Tensor, ...]
    rotation: tuple[Tensor, ...]
    color: Float[Tensor, "m 3"]


@dataclass(frozen=True, slots=True)
class Asked:
    """From where N anchors are seen, and in which appearance.

    Attributes:
        direction: Unit vectors from the camera, [N, 3].
        distance: From the camera, [N, 1].
        appearance_id: Which appearance, where there is a choice.
    """

    direction: Float[Tensor, "n 3"]
    distance: Float[Tensor, "n 1"]
    appearance_id: Int[Tensor, "1"] | None = None


class _Layers(nn.Module):
    """Two layers with ReLU between them; the outputs of the second come in equal parts.

    Each part is a product of its own, as columns of one wide product would have to be copied.
    """

    def __init__(self, hidden: Tensor, mlp: Mlp, per_anchor: int, parts: int = 1) -> None:
        super().__init__()
        self.hidden = Dense(hidden, mlp.hidden_bias)
        columns = mlp.out.shape[0] // (per_anchor * parts)
        shaped = mlp.out.reshape(per_anchor, parts, columns, -1)
        biases = mlp.out_bias.reshape(per_anchor, parts, columns)
        self.outs = nn.ModuleList(
            Dense(shaped[:, part].flatten(0, 1), biases[:, part].flatten())
            for part in range(parts)
        )

    def forward(self, inputs: Tensor, bias: Tensor | None = None) -> list[Tensor]:
        """Apply both; ``bias`` takes the place of the first one's."""
        first = self.hidden
        made = torch.relu(first(inputs) if bias is None else inputs @ first.weight + bias)
        return [out(made) for out in self.outs]


class AnchorHeads(nn.Module):
    """Decodes features by the direction and the distance from which they are seen.

    Inputs of the published networks are concatenated as feature, direction, (distance), (level),
    (appearance). Here one tensor holds the first four for all heads, zeros in a weight taking the
    place of an input that a head does not have, and the appearance, which is the same for all
    anchors, is multiplied out beforehand: one row of bias for each training camera.
    """

    feature: Tensor
    level: Tensor | None
    looks: Tensor | None

    def __init__(
        self, cloud: AnchorCloud, nets: AnchorNets, appearance: int | None = None
    ) -> None:
        """Fold what does not change.

        Args:
            cloud: The anchors.
            nets: Their networks.
            appearance: Which appearance to keep; all where absent.
        """
        super().__init__()
        self.per_anchor = cloud.per_anchor
        self.width = cloud.width
        heads = (nets.opacity, nets.covariance, nets.color)
        self.distance = any(head.distance for head in heads)
        self.bank_distance = nets.bank is not None and nets.bank.distance
        self.register_buffer("feature", cloud.feature)
        level = cloud.level[:, None] if nets.level and cloud.level is not None else None
        self.register_buffer("level", level)
        self.opacity = self._layers(nets.opacity)
        self.covariance = self._layers(nets.covariance, _COVARIANCE)
        self.color = self._layers(nets.color)
        bank = nets.bank
        self.bank = _Layers(bank.hidden, bank, 1) if bank is not None else None
        self.register_buffer("looks", self._looks(nets, appearance))

    @property
    def appearances(self) -> int:
        """How many appearances there are to choose from; 0 where there is no choice."""
        looks = self.looks
        return 0 if looks is None or looks.shape[0] == 1 else int(looks.shape[0])

    def _layers(self, mlp: Mlp, parts: int = 1) -> _Layers:
        hidden = [mlp.hidden[:, : self.width + 3]]
        at = self.width + 3
        if self.distance:
            column = mlp.hidden[:, at : at + 1] if mlp.distance else 0 * mlp.hidden[:, :1]
            hidden.append(column)
        at += mlp.distance
        if self.level is not None:
            hidden.append(mlp.hidden[:, at : at + 1])
        return _Layers(torch.cat(hidden, dim=1), mlp, self.per_anchor, parts)

    def _looks(self, nets: AnchorNets, appearance: int | None) -> Tensor | None:
        """Return the colour head's first bias for each appearance, or None without any."""
        if nets.embedding is None:
            return None
        rows = nets.embedding if appearance is None else nets.embedding[appearance][None]
        weight = nets.color.hidden[:, -nets.embedding.shape[1] :]
        return rows @ weight.t() + nets.color.hidden_bias

    def forward(self, asked: Asked, rows: Int[Tensor, " n"] | None = None) -> Decoded:
        """Decode anchors for one camera.

        Args:
            asked: From where each is seen.
            rows: Which anchors they are; all, in order, where absent.
        """
        feature = self.feature
        levels = [] if self.level is None else [self.level]
        if rows is not None:
            feature = torch.index_select(feature, 0, rows)
            levels = [torch.index_select(one, 0, rows) for one in levels]
        parts = [self._mixed(feature, levels, asked), asked.direction]
        parts += [asked.distance] if self.distance else []
        inputs = torch.cat([*parts, *levels], dim=1)
        looks = self.looks
        if looks is not None and asked.appearance_id is not None:
            looks = torch.index_select(looks, 0, asked.appearance_id)
        (opacity,) = self.opacity(inputs)
        planes = tuple(self.covariance(inputs))
        (color,) = self.color(inputs, looks)
        return Decoded(torch.tanh(opacity), planes[:3], planes[3:], color.reshape(-1, 3))

    def _mixed(self, feature: Tensor, levels: list[Tensor], asked: Asked) -> Tensor:
        """Mix three resolutions of a feature: every fourth number, every second, all.

        A coarse one is laid side by side (a b a b), not stretched (a a b b).
        """
        if self.bank is None:
            return feature
        more = [asked.distance] if self.bank_distance else levels
        (weight,) = self.bank(torch.cat([asked.direction, *more], dim=1))
        share = torch.softmax(weight, dim=1)
        mixed = feature[:, ::4].repeat(1, 4) * share[:, 0:1]
        mixed = mixed + feature[:, ::2].repeat(1, 2) * share[:, 1:2]
        return mixed + feature * share[:, 2:3]
