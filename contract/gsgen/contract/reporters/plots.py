"""Plots of rule findings as inline SVG: a histogram, or a number against its limits."""

__all__ = ["histogram", "number_line"]


from gsgen.contract._safe_text import for_html
from gsgen.contract.validation.finding import Distribution, Statistic

_WIDTH, _PLOT_HEIGHT = 480, 120
_MARGIN_PIXELS, _BASELINE_Y = 8, 96
# The axis of a number line is wider than what it shows, by this share.
_MARGIN_FRACTION = 0.15


def histogram(distribution: Distribution, name: str) -> str:
    """Return an SVG histogram of the values that a rule checked, valid and invalid ones stacked."""
    bin_counts = list(zip(distribution.valid, distribution.invalid, strict=True))
    max_count = max(valid + invalid for valid, invalid in bin_counts)
    width = (_WIDTH - 2 * _MARGIN_PIXELS) / len(bin_counts)
    parts = []
    for number, (valid, invalid) in enumerate(bin_counts):
        left, stack_top = _MARGIN_PIXELS + number * width, float(_BASELINE_Y)
        for count, kind in ((valid, "valid"), (invalid, "invalid")):
            height = (_BASELINE_Y - _MARGIN_PIXELS) * count / max(max_count, 1)
            stack_top -= height
            if count:
                parts.append(_bar_svg(kind, left, stack_top, width - 1, height))
    low, high = _format_number(distribution.low), _format_number(distribution.high)
    parts += [
        _label_svg(_MARGIN_PIXELS, "start", low),
        _label_svg(_WIDTH - _MARGIN_PIXELS, "end", high),
    ]
    invalid_count = sum(distribution.invalid)
    label = (
        f"Values of {name}: {invalid_count} of {sum(distribution.valid) + invalid_count} sampled rows "
        f"break the rule"
    )
    return _svg_document(parts, label)


def number_line(statistic: Statistic) -> str:
    """Return an SVG plot of a number as a mark, and its allowed range as a band."""
    limits = [limit for limit in (statistic.low, statistic.high) if limit is not None]
    ends = [*limits, statistic.value]
    room = _MARGIN_FRACTION * ((max(ends) - min(ends)) or abs(statistic.value) or 1.0)
    low, high = min(ends) - room, max(ends) + room

    def position(value: float) -> float:
        return _MARGIN_PIXELS + (_WIDTH - 2 * _MARGIN_PIXELS) * (value - low) / (high - low)

    left = position(low if statistic.low is None else statistic.low)
    right = position(high if statistic.high is None else statistic.high)
    mark_x = position(statistic.value)
    parts = [
        _bar_svg("allowed", left, 40, right - left, 24),
        _bar_svg("invalid", mark_x - 1.5, 28, 3, 48),
    ]
    parts += [_label_svg(position(limit), "middle", _format_number(limit)) for limit in limits]
    parts.append(_label_svg(mark_x, "middle", _format_number(statistic.value), top=20))
    return _svg_document(
        parts, f"{statistic.name}: {_format_number(statistic.value)}, allowed range shaded"
    )


def _format_number(value: float) -> str:
    return f"{value:.4g}"


def _bar_svg(kind: str, left: float, top: float, width: float, height: float) -> str:
    size = f'width="{max(width, 0):.1f}" height="{height:.1f}"'
    return f'<rect class="{kind}" x="{left:.1f}" y="{top:.1f}" {size}/>'


def _label_svg(left: float, anchor: str, text: str, top: float = 114) -> str:
    return f'<text x="{left:.1f}" y="{top:g}" text-anchor="{anchor}">{for_html(text)}</text>'


def _svg_document(parts: list[str], label: str) -> str:
    label_html = for_html(label)
    size = f'viewBox="0 0 {_WIDTH} {_PLOT_HEIGHT}"'
    image = f'<svg role="img" aria-label="{label_html}" {size}>{"".join(parts)}</svg>'
    return f"<figure>{image}<figcaption>{label_html}</figcaption></figure>"
