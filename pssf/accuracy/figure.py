"""Error against run time, drawn."""

import io

from matplotlib.figure import Figure

from .engines import Row

_COLOURS = {"embree": "#d1495b", "scanline": "#00798c"}


def draw(engines: list[Row]) -> bytes:
    """A PNG of what `engine_rows` gives: seconds against the errors of tessellation and engine, and the best front."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    total, own = figure.subplots(1, 2)
    side = max(row["pixels"] for row in engines if row["pixels"] <= 2048**2)
    chosen = [row for row in engines if row["pixels"] == side]
    for engine, colour in _COLOURS.items():
        for precision, marker in (("float32", "o"), ("float64", "D")):
            rows = [row for row in chosen if (row["engine"], row["precision"]) == (engine, precision)]
            seconds = [row["seconds"] for row in rows]
            label = f"{engine}, {precision}"
            total.plot(
                seconds, [_error(row) for row in rows], marker=marker, color=colour, lw=0.8, alpha=0.7, label=label
            )
            own.plot(seconds, [row["engine_error_mm"] for row in rows], marker, color=colour, alpha=0.7, label=label)
    front = best_front([(row["seconds"], _error(row)) for row in chosen])
    total.step(*zip(*front, strict=True), where="post", color="black", lw=2.5, alpha=0.35, label="best front")
    for axes, title in (
        (total, "against the sphere: tessellation and engine, RMS"),
        (own, "against the polyhedron: the engine alone, greatest"),
    ):
        axes.set(xscale="log", yscale="log", xlabel="seconds", ylabel="error, mm")
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.3)
    for row in chosen:
        if row["precision"] == "float32":
            note = f"{row['triangles'] / 1000:,.0f} k"
            total.annotate(note, (row["seconds"], _error(row)), xytext=(4, 5), textcoords="offset points", fontsize=7)
    total.legend(fontsize=8)
    figure.suptitle(f"A sphere of 60 mm on {side / 1e6:.1f} million pixels, by number of triangles", fontsize=11)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=130)
    return buffer.getvalue()


def best_front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Of (seconds, error), those that no other beats in both, by seconds."""
    front: list[tuple[float, float]] = []
    for seconds, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((seconds, error))
    return front


def _error(row: Row) -> float:
    return float((row["tessellation_rms_mm"] ** 2 + row["engine_error_mm"] ** 2) ** 0.5)
