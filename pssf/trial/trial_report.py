"""Report of a trial: the figure of subjects per arm, causes of error, and tables."""

import base64
import io
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ..data.analysis.trial_table import TrialDesign
from .trial_statistics import ALIGNED_MM, POWER

# Names of measures, readers and causes in the report.
MEASURE_NAMES = {
    "medial_mm": "minimum medial JSW",
    "lateral_mm": "minimum lateral JSW",
    "fixed_mm": "medial JSW(0.225)",
    "mean_mm": "mean medial JSW",
    "narrowing": "OARSI medial narrowing",
    "vot_MeanDimension": "VOT, mean dimension",
    "fsa_HorizontalDimension": "fractal signature, horizontal",
    "fsa_VerticalDimension": "fractal signature, vertical",
}
READER_NAMES = {
    "label": "exact (projected joint space)",
    "network": "reader of the package",
    "human": "human reader (assumed error)",
    "image": "image",
}
# Colours of Okabe and Ito 2008.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
# Largest number of subjects that the figure shows.
_MOST_SUBJECTS = 10_000


def render_trial_page(design: TrialDesign, tables: dict[str, pd.DataFrame]) -> str:
    """Render the report of a trial as an HTML page.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    tables : dict of str to DataFrame
        Tables ``measures``, ``causes``, ``alignment``, ``sites``, ``site_recognition`` and ``planned_power``.

    Returns
    -------
    str
        Complete HTML page.
    """
    environment = jinja2.Environment(loader=jinja2.PackageLoader(__package__, "."), autoescape=True, trim_blocks=True)
    environment.filters["number"] = _format_number
    return environment.get_template("trial.html.j2").render(
        design=design,
        visits=", ".join(f"{month:g}" for month in design.visits_months),
        summary=_summarise(design, tables["measures"]),
        subjects_figure=_encode(_draw_subjects(tables["measures"])),
        causes_figure=_encode(_draw_causes(tables["causes"])),
        measures=_name_rows(tables["measures"]),
        causes=_name_rows(tables["causes"].dropna(subset=["share"])),
        alignment=_name_rows(tables["alignment"]),
        power=_name_rows(tables["planned_power"]),
        sites=_name_rows(tables["sites"].dropna(subset=["difference"])),
        recognition=_name_rows(tables["site_recognition"].dropna(subset=["balanced_accuracy"])),
        aligned_mm=ALIGNED_MM,
        power_percent=round(100 * POWER),
    )


def _summarise(design: TrialDesign, measures: pd.DataFrame) -> str:
    """Say in one sentence which view and measure needs the fewest subjects."""
    of_readers = measures[measures["reader"].isin(("network", "human"))]
    known = of_readers[np.isfinite(of_readers["subjects_per_arm"])]
    if known.empty:
        return "This trial gives no number of subjects: too few knees, no effect of the treatment, or only one visit."
    best = known.loc[known["subjects_per_arm"].idxmin()]
    return (
        f"A treatment that slows the loss of joint space by {100 * design.treatment.fraction:.0f} % over "
        f"{design.visits_months[-1]:g} months needs the fewest knees with {MEASURE_NAMES[best['measure']]} in the view "
        f"{best['view']}, measured by the {READER_NAMES[best['reader']]}: {best['subjects_per_arm']:.0f} per arm "
        f"(95 % interval {_format_number(best['subjects_per_arm_low'])} to "
        f"{_format_number(best['subjects_per_arm_high'])})."
    )


def _name_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table with readable names of measures and readers."""
    named = table.copy()
    for column, names in (("measure", MEASURE_NAMES), ("reader", READER_NAMES), ("predictors", READER_NAMES)):
        if column in named:
            named[column] = named[column].map(lambda name, names=names: names.get(name, name))
    return named.to_dict("records")


def _format_number(value: float, digits: int = 0) -> str:
    """Format a number; "n/a" if it is unknown, and "no effect" if it is infinite."""
    if value is None or np.isnan(value):
        return "n/a"
    return "no effect" if np.isinf(value) else f"{value:,.{digits}f}"


def _draw_subjects(measures: pd.DataFrame) -> Figure:
    """Draw the number of subjects per arm by view, reader and measure, with intervals."""
    shown = measures[np.isfinite(measures["subjects_per_arm"])]
    labels = list(dict.fromkeys(shown["measure"]))
    readers = list(dict.fromkeys(shown["reader"]))
    views = list(dict.fromkeys(shown["view"]))
    figure = Figure(figsize=(10, 0.6 + 0.32 * max(1, len(labels) * len(views))), layout="constrained")
    panels = figure.subplots(1, max(1, len(readers)), sharey=True, squeeze=False)[0]
    names = [f"{view}, {MEASURE_NAMES[measure]}" for measure in labels for view in views]
    for panel, reader in zip(panels, readers, strict=False):
        own = shown[shown["reader"] == reader]
        for row in own.to_dict("records"):
            place = names.index(f"{row['view']}, {MEASURE_NAMES[row['measure']]}")
            low, high = (np.clip(row[f"subjects_per_arm{end}"], 1, _MOST_SUBJECTS) for end in ("_low", "_high"))
            value = min(row["subjects_per_arm"], _MOST_SUBJECTS)
            colour = _COLOURS[views.index(row["view"]) % len(_COLOURS)]
            panel.plot([low, high], [place, place], color=colour, linewidth=2)
            panel.plot(value, place, "o", color=colour)
        panel.set(xscale="log", xlim=(8, 1.3 * _MOST_SUBJECTS), xlabel="knees per arm", title=READER_NAMES[reader])
        panel.grid(axis="x", alpha=0.4)
    if names:
        panels[0].set_yticks(range(len(names)), names)
        panels[0].invert_yaxis()
    return figure


def _draw_causes(causes: pd.DataFrame) -> Figure:
    """Draw the share of each cause in the variance of the minimum medial joint space, by view and reader."""
    shown = causes[(causes["measure"] == "medial_mm") & np.isfinite(causes["share"])]
    readers, views = (list(dict.fromkeys(shown[name])) for name in ("reader", "view"))
    listed = list(dict.fromkeys(shown["cause"]))
    figure = Figure(figsize=(10, 0.8 + 0.45 * max(2, len(listed))), layout="constrained")
    panels = figure.subplots(1, max(1, len(readers)), sharey=True, squeeze=False)[0]
    height = 0.8 / max(1, len(views))
    for panel, reader in zip(panels, readers, strict=False):
        for place, view in enumerate(views):
            own = shown[(shown["reader"] == reader) & (shown["view"] == view)].set_index("cause").reindex(listed)
            at = np.arange(len(listed)) + (place - (len(views) - 1) / 2) * height
            panel.barh(at, own["share"], height, color=_COLOURS[place % len(_COLOURS)], label=view)
            panel.hlines(at, own["share_low"], own["share_high"], color="black", linewidth=1)
        panel.axvline(0, color="black", linewidth=0.8)
        panel.set(xlabel="share of the variance", title=READER_NAMES[reader], xlim=(-0.6, 1.05))
    if listed:
        panels[0].set_yticks(range(len(listed)), listed)
        panels[0].invert_yaxis()
        panels[-1].legend(fontsize=8)
    return figure


def _encode(figure: Figure) -> str:
    """Encode a figure as PNG in base64."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return base64.b64encode(stream.getvalue()).decode()
