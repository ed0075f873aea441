"""Figures of features, as PNG."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....radiomics.features.feature_families import ALL_FAMILIES, feature_family
from ...design.study_settings import MODELS
from ...statistics.features.reliability import ICC_FORMS, ICC_THRESHOLD
from .result_figures import MODEL_COLOURS, encode_png, format_protocol

# Feature family -> label in figures and tables.
FAMILY_NAMES = dict(
    zip(
        ALL_FAMILIES,
        (
            *("First order", "Shape", "GLCM", "GLRLM", "GLSZM", "NGTDM", "GLDM"),
            *("Fractal signature", "VOT", "HOT", "Binary patterns", "Spectrum"),
        ),
        strict=True,
    )
)
# Colours of Okabe and Ito 2008 for the families of radiomics, and of Tol 2021 (muted) for the others.
_FAMILY_COLOURS = dict(
    zip(
        ALL_FAMILIES,
        (
            *("#000000", "#E69F00", "#0072B2", "#56B4E9", "#D55E00", "#009E73", "#CC79A7"),
            *("#332288", "#882255", "#999933", "#44AA99", "#CC6677"),
        ),
        strict=True,
    )
)


def draw_stability_and_importance(
    reliability: pd.DataFrame, importance: pd.DataFrame, strongest_parameters: pd.DataFrame, max_features: int = 16
) -> bytes:
    """Draw ICC(2,1) of every feature for every set of conditions, and the importance of the leading features.

    Parameters
    ----------
    reliability : DataFrame
        Concatenated tables from `compute_reliability` and `compute_repeatability`.
    importance : DataFrame
        Columns feature and importance: mean importance over models and splits.
    strongest_parameters : DataFrame
        Table from `select_strongest_correlations`; its parameters are printed next to the bars.
    max_features : int, default 16
        Number of features in the right panel.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    figure = Figure(figsize=(11.0, 6.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    shown = _draw_stability(left, reliability)
    bar = figure.colorbar(shown, ax=left, shrink=0.6, pad=0.02, extend="min")
    bar.ax.axhline(ICC_THRESHOLD, color="white", linewidth=1.5)
    bar.set_label(f"{ICC_FORMS[0]} (line: 0.90; grey: undefined)", fontsize=8)
    _draw_leading_features(
        right, importance.sort_values("importance", ascending=False).head(max_features), strongest_parameters
    )
    return encode_png(figure)


def _draw_stability(axis: Any, reliability: pd.DataFrame) -> Any:
    """Draw an ICC heat map; rows are features sorted by family and mean ICC, columns are sets of conditions."""
    sets = list(dict.fromkeys(reliability["conditions"]))
    table = reliability.pivot(index="feature", columns="conditions", values=ICC_FORMS[0])[sets]
    mean = table.mean(axis=1)
    order = sorted(
        table.index, key=lambda name: (ALL_FAMILIES.index(feature_family(name)), -np.nan_to_num(mean[name], nan=-9))
    )
    axis.set_facecolor("0.82")
    values = table.loc[order].to_numpy(dtype=float)
    shown = axis.imshow(values, cmap="viridis", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
    families = [feature_family(name) for name in order]
    starts = [row for row in range(len(order)) if not row or families[row] != families[row - 1]]
    for row in starts[1:]:
        axis.axhline(row - 0.5, color="white", linewidth=2)
    middles = [(first + last - 1) / 2 for first, last in zip(starts, [*starts[1:], len(order)], strict=True)]
    axis.set_yticks(middles, [FAMILY_NAMES[families[row]] for row in starts], fontsize=8)
    stable = (table >= ICC_THRESHOLD).sum()
    labels = [f"{format_protocol(name)}\n({stable[name]} of {table[name].notna().sum()} stable)" for name in sets]
    axis.set_xticks(range(len(sets)), labels, fontsize=7, rotation=90)
    axis.tick_params(length=0)
    return shown


def _draw_leading_features(axis: Any, importance: pd.DataFrame, strongest_parameters: pd.DataFrame) -> None:
    """Draw the importance of the most important features as bars."""
    names, values = importance["feature"].tolist(), importance["importance"].to_numpy(float)
    axis.barh(range(len(names)), values, color=[_FAMILY_COLOURS[feature_family(name)] for name in names])
    axis.set_yticks(range(len(names)), [name.split("_", 1)[1].replace("_", " ") for name in names], fontsize=8)
    axis.invert_yaxis()
    known = strongest_parameters.set_index("feature")
    for row, (name, value) in enumerate(zip(names, values, strict=True)):
        if name in known.index:
            strongest = f"{known.loc[name, 'parameter'].split(',')[0]} {known.loc[name, 'rho']:+.2f}".replace("-", "−")
            axis.text(value + 0.01 * values.max(), row, strongest, va="center", fontsize=7.5, color="0.25")
    axis.set_xlim(0, 1.35 * values.max())
    axis.set_xlabel("mean importance", fontsize=9)
    axis.spines[["top", "right"]].set_visible(False)
    present = [name for name in ALL_FAMILIES if name in {feature_family(one) for one in names}]
    handles = [Patch(color=_FAMILY_COLOURS[name], label=FAMILY_NAMES[name]) for name in present]
    axis.legend(handles=handles, fontsize=8, frameon=False, loc="lower right")


def draw_icc_heat_map(reliability: pd.DataFrame) -> bytes:
    """Draw a heat map of the ICC of every feature, split into two panels, with features sorted by family.

    Parameters
    ----------
    reliability : DataFrame
        Concatenated tables from `compute_reliability` and `compute_repeatability`.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    table = reliability.pivot(index="feature", columns="conditions", values=list(ICC_FORMS))
    sets = list(dict.fromkeys(reliability["conditions"]))
    columns = [(form, label) for form in ICC_FORMS for label in sets]
    order = sorted(table.index, key=lambda name: (ALL_FAMILIES.index(feature_family(name)), name))
    values = table.loc[order, columns].to_numpy(dtype=float)
    half = -(-len(order) // 2)
    figure = Figure(figsize=(10.2, 0.17 * half + 2.2), layout="constrained")
    axes = figure.subplots(1, 2)
    shown: Any = None
    for axis, start in zip(axes, (0, half), strict=True):
        block = values[start : start + half]
        axis.set_facecolor("0.82")  # The background is visible where an ICC is undefined.
        shown = axis.imshow(block, cmap="viridis", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
        axis.set_xticks(
            range(len(columns)), [f"{form}, {format_protocol(label)}" for form, label in columns], fontsize=7.5
        )
        axis.tick_params(axis="x", rotation=90)
        axis.set_yticks(range(len(block)), order[start : start + half], fontsize=7.5)
        for row, name in enumerate(order[start : start + half]):
            if row and feature_family(name) != feature_family(order[start + row - 1]):
                axis.axhline(row - 0.5, color="white", linewidth=1.5)
        axis.axvline(len(sets) - 0.5, color="white", linewidth=1.5)
    bar = figure.colorbar(shown, ax=axes, shrink=0.5, pad=0.01, extend="min")
    bar.ax.axhline(0.9, color="white", linewidth=1.5)
    bar.set_label("ICC (line: 0.90; grey: undefined)", fontsize=8)
    return encode_png(figure)


def draw_family_bars(families: pd.DataFrame) -> bytes:
    """Draw the importance of each feature family, one bar per model.

    Parameters
    ----------
    families : DataFrame
        Table from `sum_by_family`.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / max(1, families.shape[1])
    for index, model in enumerate(families.columns):
        at = np.arange(len(families)) + (index - (families.shape[1] - 1) / 2) * width
        axis.bar(at, families[model], width * 0.92, color=MODEL_COLOURS[model], label=MODELS[model])
    axis.set_xticks(range(len(families)), [FAMILY_NAMES[name] for name in families.index])
    axis.set_ylabel("mean importance")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=9)
    return encode_png(figure)
