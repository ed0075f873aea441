"""The pictures of the report that are about features, as PNG."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...radiomics.families import FAMILIES, family
from ..settings import MODELS
from ..statistics.reliability import ICC_FORMS, THRESHOLD
from .figures import COLOURS, plain, png

FAMILY_NAMES = dict(zip(FAMILIES, ("First order", "Shape", "GLCM", "GLRLM", "GLSZM", "NGTDM", "GLDM"), strict=True))
# Okabe & Ito 2008, a colour a family.
_FAMILY_COLOURS = dict(
    zip(FAMILIES, ("#000000", "#E69F00", "#0072B2", "#56B4E9", "#D55E00", "#009E73", "#CC79A7"), strict=True)
)


def stability_and_importance(
    reliability: pd.DataFrame, importance: pd.DataFrame, followed: pd.DataFrame, most: int = 16
) -> bytes:
    """ICC(2,1) of every feature under every set of conditions; beside it what the models lean on.

    reliability  of `reliability.reliability` and `repeatability`
    importance   feature, share: mean share over models and splits
    followed     of `parameters.strongest`: what each feature follows, written beside its bar
    """
    figure = Figure(figsize=(11.0, 6.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    shown = _stability(left, reliability)
    bar = figure.colorbar(shown, ax=left, shrink=0.6, pad=0.02, extend="min")
    bar.ax.axhline(THRESHOLD, color="white", linewidth=1.5)
    bar.set_label(f"{ICC_FORMS[0]} (line: 0.90; grey: undefined)", fontsize=8)
    _leading(right, importance.sort_values("share", ascending=False).head(most), followed)
    return png(figure)


def _stability(axis: Any, reliability: pd.DataFrame) -> Any:
    """Rows are features by family, in each the stable ones first; columns the sets of conditions."""
    sets = list(dict.fromkeys(reliability["across"]))
    table = reliability.pivot(index="feature", columns="across", values=ICC_FORMS[0])[sets]
    mean = table.mean(axis=1)
    order = sorted(table.index, key=lambda name: (FAMILIES.index(family(name)), -np.nan_to_num(mean[name], nan=-9)))
    axis.set_facecolor("0.82")
    values = table.loc[order].to_numpy(dtype=float)
    shown = axis.imshow(values, cmap="viridis", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
    families = [family(name) for name in order]
    starts = [row for row in range(len(order)) if not row or families[row] != families[row - 1]]
    for row in starts[1:]:
        axis.axhline(row - 0.5, color="white", linewidth=2)
    middles = [(first + last - 1) / 2 for first, last in zip(starts, [*starts[1:], len(order)], strict=True)]
    axis.set_yticks(middles, [FAMILY_NAMES[families[row]] for row in starts], fontsize=8)
    stable = (table >= THRESHOLD).sum()
    labels = [f"{plain(name)}\n({stable[name]} of {table[name].notna().sum()} stable)" for name in sets]
    axis.set_xticks(range(len(sets)), labels, fontsize=7, rotation=90)
    axis.tick_params(length=0)
    return shown


def _leading(axis: Any, importance: pd.DataFrame, followed: pd.DataFrame) -> None:
    names, shares = importance["feature"].tolist(), importance["share"].to_numpy(float)
    axis.barh(range(len(names)), shares, color=[_FAMILY_COLOURS[family(name)] for name in names])
    axis.set_yticks(range(len(names)), [name.split("_", 1)[1].replace("_", " ") for name in names], fontsize=8)
    axis.invert_yaxis()
    known = followed.set_index("feature")
    for row, (name, share) in enumerate(zip(names, shares, strict=True)):
        if name in known.index:
            follows = f"{known.loc[name, 'parameter'].split(',')[0]} {known.loc[name, 'rho']:+.2f}".replace("-", "−")
            axis.text(share + 0.01 * shares.max(), row, follows, va="center", fontsize=7.5, color="0.25")
    axis.set_xlim(0, 1.35 * shares.max())
    axis.set_xlabel("mean share of importance", fontsize=9)
    axis.spines[["top", "right"]].set_visible(False)
    present = [name for name in FAMILIES if name in {family(one) for one in names}]
    handles = [Patch(color=_FAMILY_COLOURS[name], label=FAMILY_NAMES[name]) for name in present]
    axis.legend(handles=handles, fontsize=8, frameon=False, loc="lower right")


def heat_map(reliability: pd.DataFrame) -> bytes:
    """ICC of every feature: columns are the forms and sets of protocols, features sorted by family, in two blocks."""
    table = reliability.pivot(index="feature", columns="across", values=list(ICC_FORMS))
    sets = list(dict.fromkeys(reliability["across"]))
    columns = [(form, label) for form in ICC_FORMS for label in sets]
    order = sorted(table.index, key=lambda name: (FAMILIES.index(family(name)), name))
    values = table.loc[order, columns].to_numpy(dtype=float)
    half = -(-len(order) // 2)
    figure = Figure(figsize=(10.2, 0.17 * half + 2.2), layout="constrained")
    axes = figure.subplots(1, 2)
    shown: Any = None
    for axis, start in zip(axes, (0, half), strict=True):
        block = values[start : start + half]
        axis.set_facecolor("0.82")  # what shows through where an ICC is undefined
        shown = axis.imshow(block, cmap="viridis", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
        axis.set_xticks(range(len(columns)), [f"{form}, {plain(label)}" for form, label in columns], fontsize=7.5)
        axis.tick_params(axis="x", rotation=90)
        axis.set_yticks(range(len(block)), order[start : start + half], fontsize=7.5)
        for row, name in enumerate(order[start : start + half]):
            if row and family(name) != family(order[start + row - 1]):
                axis.axhline(row - 0.5, color="white", linewidth=1.5)
        axis.axvline(len(sets) - 0.5, color="white", linewidth=1.5)
    bar = figure.colorbar(shown, ax=axes, shrink=0.5, pad=0.01, extend="min")
    bar.ax.axhline(0.9, color="white", linewidth=1.5)
    bar.set_label("ICC (line: 0.90; grey: undefined)", fontsize=8)
    return png(figure)


def family_bars(families: pd.DataFrame) -> bytes:
    """Share of each family in what the models lean on; a bar a model."""
    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / max(1, families.shape[1])
    for index, model in enumerate(families.columns):
        at = np.arange(len(families)) + (index - (families.shape[1] - 1) / 2) * width
        axis.bar(at, families[model], width * 0.92, color=COLOURS[model], label=MODELS[model])
    axis.set_xticks(range(len(families)), [FAMILY_NAMES[name] for name in families.index])
    axis.set_ylabel("mean share of importance")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=9)
    return png(figure)
