# ruff: noqa: E501 - the SVG path of a bone is one long string
"""Define a directive that draws the axes, source and detector of a protocol as SVG in the colours of the theme."""

from math import cos, radians, sin

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata

import pssf
from pssf.geometry.view import resolve_view

# The CSS colours of the theme make the drawing legible in light and dark mode.
_LINE, _MUTED = "var(--pst-color-text-base)", "var(--pst-color-text-muted)"
_BEAM, _BONE = "var(--pst-color-primary)", "var(--pst-color-secondary)"


class AxesDrawing(SphinxDirective):
    """Draw the knee frame from the side and from the front."""

    def run(self) -> list[nodes.Node]:
        """Make one SVG with the two drawings, and a text alternative for screen readers."""
        self.env.note_dependency(__file__)
        svg = draw_side_view() + draw_front_view()
        text = (
            '<div class="axes-scroll"><svg class="axes-drawing" role="img" viewBox="0 0 760 700" xmlns="http://www.w3.org/2000/svg" '
            'aria-label="The knee frame from the side and from the front: x medial, y towards the detector, z proximal">'
            f"{_STYLE}{svg}</svg></div>"
        )
        return [nodes.raw("", text, format="html")]


_STYLE = (
    "<style>.axes-drawing text{font:15px sans-serif;fill:"
    + _LINE
    + "}.axes-drawing .m{fill:"
    + _MUTED
    + ";font-size:13px}"
    ".axes-drawing .b{fill:"
    + _BEAM
    + "}.axes-drawing line,.axes-drawing path,.axes-drawing rect,.axes-drawing ellipse,"
    ".axes-drawing circle{fill:none;stroke:" + _LINE + ";stroke-width:1.6}.axes-drawing .ray{stroke:" + _BEAM + "}"
    ".axes-drawing .dim{stroke:"
    + _MUTED
    + ";stroke-width:1;stroke-dasharray:4 3}.axes-drawing .bone{stroke:"
    + _BONE
    + ";"
    "stroke-width:2}.axes-drawing .fill{fill:" + _LINE + "}</style>"
)


def draw_side_view() -> str:
    """Draw source, knee and detector of the protocol `reference` from the side, to scale.

    Returns
    -------
    str
        SVG elements. The scale is 0.52 px per mm; the tilted source is at a beam angle of 15 degrees.
    """
    protocol = pssf.load_protocol("reference")
    view = resolve_view(protocol)
    scale, origin_x, origin_y = 0.52, 575.0, 215.0
    place_x = lambda y_mm: origin_x + scale * y_mm  # noqa: E731
    place_y = lambda z_mm: origin_y - scale * z_mm  # noqa: E731
    source_x, detector_x = place_x(view.source_mm[1]), place_x(view.centre_mm[1])
    half = view.rows * view.pixel_mm / 2
    parts = [_text(380, 24, "From the medial side of a right knee, to scale", "middle")]
    # The beam is drawn as the central ray and the rays to the two edges of the detector.
    for z_mm, kind in ((0.0, "ray"), (half, "dim"), (-half, "dim")):
        parts.append(_line(source_x, origin_y, detector_x, place_y(z_mm), kind))
    parts.append(f'<circle class="fill" cx="{source_x}" cy="{origin_y}" r="4"/>')
    parts.append(_text(source_x, origin_y + 24, "source", "start"))
    angle = radians(15)
    tilted = (place_x(view.source_mm[1] * cos(angle)), place_y(-view.source_mm[1] * sin(angle)))
    parts += [_line(*tilted, origin_x, origin_y, "dim"), f'<circle cx="{tilted[0]:.1f}" cy="{tilted[1]:.1f}" r="4"/>']
    parts.append(
        _text(tilted[0] + 12, tilted[1] - 4, "beam_angle_deg > 0: source proximal, beam points caudally", "start", "m")
    )
    # Draw the bones and the detector.
    parts.append(
        f'<path class="bone" d="M{origin_x - 22} {place_y(130)} L{origin_x - 16} {place_y(45)} Q{origin_x - 32} {place_y(8)} {origin_x} {place_y(5)} Q{origin_x + 34} {place_y(12)} {origin_x + 12} {place_y(50)} L{origin_x + 8} {place_y(130)}"/>'
    )
    parts.append(
        f'<path class="bone" d="M{origin_x - 14} {place_y(-130)} L{origin_x - 16} {place_y(-60)} L{origin_x - 26} {place_y(-6)} L{origin_x + 24} {place_y(-9)} L{origin_x + 10} {place_y(-60)} L{origin_x + 8} {place_y(-130)}"/>'
    )
    parts.append(f'<ellipse class="bone" cx="{origin_x - 38}" cy="{place_y(30)}" rx="8" ry="13"/>')
    parts.append(f'<rect x="{detector_x}" y="{place_y(half)}" width="8" height="{2 * half * scale:.1f}"/>')
    parts.append(_text(detector_x + 14, place_y(-half) + 4, "detector", "start"))
    # Draw the y and z axes of the knee frame.
    parts += _arrow(origin_x, origin_y, origin_x + 62, origin_y) + _arrow(origin_x, origin_y, origin_x, origin_y - 74)
    parts += [
        _text(origin_x + 48, origin_y - 8, "+y", "start", "b"),
        _text(origin_x + 22, origin_y - 64, "+z", "start", "b"),
    ]
    # Draw dimension lines for the source-object and source-detector distances.
    for label, end, y in (
        (f"SOD {protocol.sod_mm:g} mm", origin_x, 330),
        (f"SDD {protocol.sdd_mm:g} mm", detector_x, 358),
    ):
        parts += [_line(source_x, y, end, y, "dim"), _text((source_x + end) / 2, y - 5, label, "middle", "m")]
        parts += [_line(x, y - 5, x, y + 5, "dim") for x in (source_x, end)]
    parts.append(_text(origin_x - 44, place_y(-62), "anterior", "end", "m"))
    return "".join(parts)


def draw_front_view() -> str:
    """Draw a right knee from the front and its image, not to scale.

    Returns
    -------
    str
        SVG elements.
    """
    x, y = 230.0, 550.0
    parts = [_text(x, 415, "From the front, right knee (AP)", "middle")]
    parts.append(
        f'<path class="bone" d="M{x - 20} {y - 110} L{x - 22} {y - 60} Q{x - 60} {y - 30} {x - 50} {y - 12} Q{x - 30} {y + 4} {x - 10} {y - 16} Q{x} {y - 30} {x + 10} {y - 16} Q{x + 32} {y + 4} {x + 50} {y - 12} Q{x + 60} {y - 30} {x + 22} {y - 60} L{x + 20} {y - 110}"/>'
    )
    parts.append(
        f'<path class="bone" d="M{x - 18} {y + 115} L{x - 20} {y + 60} Q{x - 56} {y + 30} {x - 54} {y + 6} L{x - 10} {y + 4} L{x - 5} {y - 8} L{x} {y + 2} L{x + 6} {y - 9} L{x + 11} {y + 4} L{x + 54} {y + 6} Q{x + 54} {y + 30} {x + 20} {y + 60} L{x + 18} {y + 115}"/>'
    )
    parts.append(
        f'<path class="bone" d="M{x - 50} {y + 115} L{x - 48} {y + 62} Q{x - 66} {y + 42} {x - 52} {y + 28} Q{x - 38} {y + 36} {x - 38} {y + 62} L{x - 40} {y + 115}"/>'
    )
    parts.append(_text(x - 70, y + 60, "fibula", "end", "m"))
    parts += _arrow(x, y, x + 104, y) + _arrow(x, y, x, y - 104)
    parts += [_text(x + 78, y - 8, "+x medial", "start", "b"), _text(x + 30, y - 92, "+z proximal", "start", "b")]
    parts.append(_text(x - 66, y - 8, "lateral", "end", "m"))
    # The image is drawn as a square with its row and column axes.
    left, top, side = 460.0, 440.0, 220.0
    parts.append(_text(left + side / 2, 415, "Its image: (rows, cols)", "middle"))
    parts.append(f'<rect x="{left}" y="{top}" width="{side}" height="{side}"/>')
    parts += _arrow(left + 14, top + 14, left + 100, top + 14) + _arrow(left + 14, top + 14, left + 14, top + 100)
    parts += [_text(left + 106, top + 19, "columns, +x", "start"), _text(left + 22, top + 96, "rows, -z", "start")]
    parts.append(f'<circle class="fill" cx="{left + 14}" cy="{top + 14}" r="3"/>')
    parts.append(_text(left + 22, top + 40, "pixel (0, 0): proximal", "start", "m"))
    parts.append(_text(left + side / 2, top + 150, "fibula of a right knee: left", "middle", "m"))
    parts.append(_text(left + side / 2, top + 172, "fibula of a left knee: right", "middle", "m"))
    return "".join(parts)


def _line(x1: float, y1: float, x2: float, y2: float, kind: str = "") -> str:
    """Make an SVG line; `kind` is its CSS class."""
    return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _arrow(x1: float, y1: float, x2: float, y2: float) -> list[str]:
    """Make a horizontal or vertical SVG arrow."""
    dx, dy = (x2 > x1) - (x2 < x1), (y2 > y1) - (y2 < y1)
    tip = f"M{x2 - 8 * dx - 4 * dy} {y2 - 8 * dy - 4 * dx} L{x2} {y2} L{x2 - 8 * dx + 4 * dy} {y2 - 8 * dy + 4 * dx}"
    return [_line(x1, y1, x2, y2, "ray"), f'<path class="ray" d="{tip}"/>']


def _text(x: float, y: float, text: str, anchor: str, kind: str = "") -> str:
    """Make an SVG text; `anchor` is start, middle or end, and `kind` is its CSS class."""
    safe = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{safe}</text>'


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directive."""
    app.add_directive("axes-drawing", AxesDrawing)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
