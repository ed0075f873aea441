"""Figure of ray-casting error against run time."""

import io

from matplotlib.figure import Figure

from .raycasting.raycast_engines import Row

_COLOURS = {"embree": "#d1495b", "scanline": "#00798c"}


def plot_error_against_time(engine_results: list[Row]) -> bytes:
    """Plot ray-casting error against run time, with the Pareto front.

    The left panel shows tessellation and engine error combined, and the right panel the engine error. The detector size
    is the largest size in the results that has at most 2048 x 2048 pixels.

    Parameters
    ----------
    engine_results : list of dict
        Rows of :func:`~pssf.validation.raycasting.raycast_engines.measure_engines`.

    Returns
    -------
    bytes
        PNG image.
    """
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    total, own = figure.subplots(1, 2)
    side = max(row["pixels"] for row in engine_results if row["pixels"] <= 2048**2)
    chosen = [row for row in engine_results if row["pixels"] == side]
    for engine, colour in _COLOURS.items():
        for precision, marker in (("float32", "o"), ("float64", "D")):
            rows = [row for row in chosen if (row["engine"], row["precision"]) == (engine, precision)]
            seconds = [row["seconds"] for row in rows]
            label = f"{engine}, {precision}"
            total.plot(
                seconds,
                [_total_error_mm(row) for row in rows],
                marker=marker,
                color=colour,
                lw=0.8,
                alpha=0.7,
                label=label,
            )
            own.plot(seconds, [row["engine_error_mm"] for row in rows], marker, color=colour, alpha=0.7, label=label)
    front = find_pareto_front([(row["seconds"], _total_error_mm(row)) for row in chosen])
    total.step(*zip(*front, strict=True), where="post", color="black", lw=2.5, alpha=0.35, label="Pareto front")
    for axes, title in (
        (total, "error relative to the sphere: tessellation (RMS) and engine"),
        (own, "error relative to the polyhedron: engine only, maximum"),
    ):
        axes.set(xscale="log", yscale="log", xlabel="run time (s)", ylabel="error (mm)")
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.3)
    for row in chosen:
        if row["precision"] == "float32":
            note = f"{row['triangles'] / 1000:,.0f} k"
            total.annotate(
                note, (row["seconds"], _total_error_mm(row)), xytext=(4, 5), textcoords="offset points", fontsize=7
            )
    total.legend(fontsize=8)
    figure.suptitle(f"Sphere of 60 mm radius, {side / 1e6:.1f} million pixels, by number of triangles", fontsize=11)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=130)
    return buffer.getvalue()


def find_pareto_front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Select the points for which no other point has both a shorter run time and a smaller error.

    Parameters
    ----------
    points : list of tuple of float
        Run time in seconds and error of each point.

    Returns
    -------
    list of tuple of float
        Points of the Pareto front, sorted by run time.
    """
    front: list[tuple[float, float]] = []
    for seconds, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((seconds, error))
    return front


def _total_error_mm(row: Row) -> float:
    """Combine tessellation and engine error in quadrature, in mm."""
    return float((row["tessellation_rms_mm"] ** 2 + row["engine_error_mm"] ** 2) ** 0.5)
