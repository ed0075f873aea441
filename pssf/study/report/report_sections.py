"""Sections of the report that consist of sentences, figures and one table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from ..design.response_curve_design import ProtocolAxis
from ..design.sensitivity_plan import PARAMETER_SPACE
from ..learn.confounded_training import CONFOUNDERS
from ..learn.incremental_value import JSW_MEASUREMENT_SD_MM, PREDICTOR_SETS
from ..statistics.analyses.incremental_value_scores import BEST_POSSIBLE
from ..statistics.analyses.learning_curves import TARGET_POWER
from . import incremental_value_figures, response_curve_figures
from .report_page import Picture, format_fixed, format_signed


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the report.

    Parameters
    ----------
    name : str
        Identifier of the section in the page.
    short_title : str
        Title in the list of sections.
    title : str
        Heading.
    sentences : sequence of str
        Paragraphs below the heading.
    table : DataFrame
        Formatted cells with printed column names; an empty table is not shown.
    note : str
        Note below the table.
    pictures : sequence of Picture
        Figures between the paragraphs and the table.
    """

    name: str
    short_title: str
    title: str
    sentences: Sequence[str]
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    note: str = ""
    pictures: Sequence[Picture] = ()


def make_segmentation_section(table: pd.DataFrame) -> list[Section]:
    """Make the section on the accuracy of the bone segmentation.

    Parameters
    ----------
    table : DataFrame
        Table of `segmentation_accuracy.evaluate_segmentation`.

    Returns
    -------
    list of Section
        One section, or none if the table is empty.
    """
    if table.empty:
        return []
    shown = [
        {
            "Grade": row["grade"],
            "Radiographs": row["radiographs"],
            "Dice": format_fixed(row["dice"]),
            "Dice, 5th percentile": format_fixed(row["dice_p5"]),
            "Outline distance, mean, mm": format_fixed(row["mean_mm"]),
            "95th percentile, mm": format_fixed(row["p95_mm"]),
            "Area, segmented / true": format_fixed(row["area"]),
        }
        for row in table.to_dict("records")
    ]
    return [
        Section(
            name="bone",
            short_title="Segmentation",
            title="Segmentation accuracy",
            sentences=(
                "Shape features are measured on the segmented bone. The table compares it with the projection of all "
                "bones, including osteophytes, in the regions of the repeat radiographs. If the two differ much, a "
                "shape feature describes where the signal crosses a threshold, and not the outline of bone.",
            ),
            table=pd.DataFrame(shown),
            note="Distances are symmetric distances between the outlines, at the joint plane. All values are in "
            "segmentation.csv.",
        )
    ]


def make_incremental_value_section(rungs: pd.DataFrame, differences: pd.DataFrame, subjects: int) -> Section:
    """Make the section on the incremental predictive value.

    Parameters
    ----------
    rungs : DataFrame
        AUC of each predictor set, as for `incremental_value_figures.draw_incremental_value`.
    differences : DataFrame
        Paired differences of AUC between predictor sets.
    subjects : int
        Number of subjects of the cohort.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="ladder",
        png=incremental_value_figures.draw_incremental_value(rungs, differences),
        alt="AUC of grade 0 vs each other grade by predictor set, and paired differences",
        caption="Top: AUC of logistic regression by predictor set, mean over the splits with 95 % interval. Dashed "
        "line: best possible AUC, a lower bound from all parameters of newly sampled knees. Bottom: paired differences "
        "of AUC on the same splits.",
    )
    shown = [
        {
            "Question": row["question"],
            "Grades": row["grades"],
            "Difference of AUC": format_signed(row["difference"]),
            "95 % interval": f"{format_signed(row['low'])} to {format_signed(row['high'])}",
            "p (Holm)": format_fixed(row["p_holm"], 3),
            "Answer": row["answer"],
        }
        for row in differences.to_dict("records")
    ]
    best = rungs[rungs["rung"] == BEST_POSSIBLE]
    drawn = f" ({int(best['knees'].iloc[0])} knees per pair of grades, held-out fifths)" if len(best) else ""
    return Section(
        name="ladder",
        short_title="Incremental value",
        title="Incremental predictive value",
        sentences=(
            "Logistic regression is trained and tested on the same splits with different predictor sets: "
            f"{', '.join(PREDICTOR_SETS.values())}. Measured JSW is true JSW plus a measurement error of "
            f"{JSW_MEASUREMENT_SD_MM} mm (Mazzuca 1999) in each compartment. It bypasses feature selection, so that "
            "the differences show what features add.",
            "Apart from trabecular texture, an image cannot predict the grade better than all parameters of a knee. "
            f"The best possible AUC is estimated by a fit to newly sampled knees{drawn}; it is a lower bound. If the "
            f"true parameters reach less than that here, {subjects} subjects are too few to train on.",
        ),
        table=pd.DataFrame(shown),
        note="Yes and no: the corrected p is below 0.05 and the splits test enough subjects; no means that the first "
        "predictor set is worse. All values are in ladder.csv and ladder_differences.csv.",
        pictures=(picture,),
    )


def make_learning_section(curves: pd.DataFrame, power: pd.DataFrame) -> Section:
    """Make the section on sample size and power.

    Parameters
    ----------
    curves : DataFrame
        Table of `learning_curves.compute_learning_curves`.
    power : DataFrame
        Table of `learning_curves.tabulate_power`.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="learning",
        png=incremental_value_figures.draw_learning_curves(curves, power),
        alt="AUC against the number of training subjects, and power against the size of a cohort, by pair of grades",
        caption="Top: AUC against the number of training subjects. The test subjects of a split are always the same, "
        "so only the training changes. Bottom: power to show the chosen difference from measured JSW against the "
        "number of subjects of a cohort. Dot: this cohort. Band: from the interval of the variance over the splits.",
    )
    shown = [
        {
            "Question": row["question"],
            "Grades": row["grades"],
            "Subjects of this cohort": row["subjects"],
            "Power of this cohort": format_fixed(row["power"]),
            f"Subjects for a power of {TARGET_POWER}": f"{row['needed']:.0f}",
            "95 % interval": f"{row['needed_low']:.0f} to {row['needed_high']:.0f}",
        }
        for row in power.to_dict("records")
    ]
    chosen = f"{power['difference'].iloc[0]:g}" if len(power) else "the chosen size"
    return Section(
        name="learning",
        short_title="Sample size",
        title="Sample size and power",
        sentences=(
            "The learning curves show how the AUC of a classifier depends on the number of training subjects. The "
            f"power is the probability that a cohort shows a difference of AUC of {chosen} at 5 %, two-sided, by the "
            "paired test of this report. The variance of a difference is assumed to fall as 1 / number of subjects.",
        ),
        table=pd.DataFrame(shown),
        note="Subjects are those of both grades in training, validation and test. The gain of each step with its "
        "interval is in learning.csv, the standard errors are in power.csv.",
        pictures=(picture,),
    )


def make_response_curves_section(
    tables: Mapping[str, pd.DataFrame],
    breaks: pd.DataFrame,
    axes: Mapping[str, ProtocolAxis],
    leading: Sequence[str],
    knees: int,
    task: str,
) -> Section:
    """Make the section on the response curves of features and models.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        Rows of the response curves, by "curve_<axis>".
    breaks : DataFrame
        Table of `breakpoints.find_breakpoints`.
    axes : mapping of str to ProtocolAxis
        Axes by name.
    leading : sequence of str
        Features that are shown one by one.
    knees : int
        Number of knees with response curves.
    task : str
        Classification task of these knees.

    Returns
    -------
    Section
        Section with one figure per axis and one table.
    """
    pictures = [
        Picture(
            name=f"curve_{name}",
            png=response_curve_figures.draw_response_curves(
                tables[f"curve_{name}"], breaks[breaks["axis"] == name], axis, leading, task
            ),
            alt=f"Change of features, their ICC, threshold shift and AUC against {axis.label}",
            caption=f"{axis.label[0].upper()}{axis.label[1:]}. From left to right: change of the most important "
            "features; their ICC(2,1) with the radiographs of the cohort; log odds by which a threshold would have to "
            "move; AUC. Orange: breakpoint of a conclusion of the table, with its interval. Dotted line: unchanged "
            "protocol.",
        )
        for name, axis in axes.items()
    ]
    shown = [
        {
            "Axis": row["axis"].replace("_", " "),
            "Conclusion": row["conclusion"],
            "Breakpoint": row["reading"],
            "Measured range": f"{row['from']:.3g} to {row['to']:.3g}",
        }
        for row in breaks.to_dict("records")
    ]
    return Section(
        name="curves",
        short_title="Response curves",
        title="Response curves",
        sentences=(
            f"{knees} knees of grade {task} are imaged again while one protocol parameter is changed in steps. Each "
            "image has its own noise. The first model and selection are trained under the unchanged protocol. In every "
            "split they are tested on half of these knees, which are not used in training.",
            "A conclusion is followed from the unchanged protocol outwards to the first step at which it fails. The "
            "interval for a median ICC is from bootstrap samples of subjects. The interval for a loss of AUC is where "
            "the ends of its 95 % interval cross the limit.",
        ),
        table=pd.DataFrame(shown),
        note="Every feature at every step is in curve_<axis>.csv, the breakpoints are in breakpoints.csv.",
        pictures=pictures,
    )


def make_sensitivity_section(
    sobol_indices: pd.DataFrame,
    sensitivities: pd.DataFrame,
    leading: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
) -> Section:
    """Make the section on the sensitivity of features to parameters of knee and protocol.

    Parameters
    ----------
    sobol_indices : DataFrame
        Table of `sensitivity_analysis.compute_sobol_indices`.
    sensitivities : DataFrame
        Table of `sensitivity_analysis.merge_sensitivity_tables`.
    leading : sequence of str
        Most important features of the models.
    bounds : mapping of str to tuple of float
        Bounds of the parameters.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="meaning",
        png=response_curve_figures.draw_sensitivity(sobol_indices, sensitivities, leading),
        alt="Total Sobol indices of parameter groups for the most important features; slopes against correlations",
        caption="Left: total Sobol index of each parameter group for the most important features: the fraction of "
        "variance that the group explains alone and in interactions (Sobol 1993). Right: slope with the noise held "
        "against correlation, one point per feature and parameter. On the line both are equal.",
    )
    part = sensitivities[sensitivities["feature"].isin(leading)].dropna(subset="slope")
    strongest = part.assign(size=part["slope"].abs()).sort_values("size", ascending=False, kind="stable")
    shown = [
        {
            "Feature": row["feature"],
            "Parameter": row["parameter"],
            "Slope, SD per SD": format_signed(row["slope"]),
            "95 % interval": f"{format_signed(row['slope_low'])} to {format_signed(row['slope_high'])}",
            "Correlation": format_signed(row["rho"]),
            "Correlation within grades": format_signed(row["rho_within"]),
        }
        for row in strongest.groupby("feature", sort=False).head(2).to_dict("records")
    ]
    spans = "; ".join(f"{PARAMETER_SPACE[name].label} {low:.3g} to {high:.3g}" for name, (low, high) in bounds.items())
    samples = f" of {int(sobol_indices['samples'].max())} samples" if len(sobol_indices) else ""
    return Section(
        name="meaning",
        short_title="Sensitivity",
        title="Sensitivity analysis",
        sentences=(
            f"Sobol indices{samples} over parameters of knee and protocol, by SALib with 95 % intervals. A slope is "
            "the change of a feature when one parameter of a knee changes by a tenth of its span while everything else "
            "is held, including the noise. A correlation over the cohort also contains associations that arise because "
            "both depend on the grade.",
            f"Range of the parameters: {spans}.",
        ),
        table=pd.DataFrame(shown),
        note="The table shows the two strongest slopes of each of the most important features. All slopes and "
        "correlations are in feature_parameter_correlations.csv, first-order and total Sobol indices are in "
        "sobol_indices.csv.",
        pictures=(picture,),
    )


def make_confounders_section(table: pd.DataFrame) -> Section:
    """Make the section on the effects of confounders.

    Parameters
    ----------
    table : DataFrame
        Table of `confounding_effects.estimate_confounding`.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="confounders",
        png=incremental_value_figures.draw_confounders(table),
        alt="AUC against the strength of the association of age, BMI or site with grade, naive and adjusted",
        caption="AUC for grade 0 vs 2 against the strength of the association in training, mean over the splits with "
        "95 % interval. Confounded test set: the association is the same as in training. Balanced test set: there is "
        "no association.",
    )
    strongest = table[table["strength"] == table["strength"].max()]
    shown = [
        {
            "Confounder": CONFOUNDERS[row["confounder"]],
            "Strength": f"{row['strength']:g}",
            "Measure": row["measure"],
            "AUC": format_fixed(row["value"]),
            "95 % interval": f"{format_fixed(row['low'])} to {format_fixed(row['high'])}",
        }
        for row in strongest.to_dict("records")
    ]
    return Section(
        name="confounders",
        short_title="Confounders",
        title="Confounders by design",
        sentences=(
            "At strength s, a fraction (1 + s)/2 of the training subjects of grade 2 is above the median age or BMI, "
            "or imaged under the second protocol. The same fraction of grade 0 is below the median, or imaged under "
            "the reference. The number of subjects does not depend on s. Test subjects are weighted so that the "
            "association is present or absent. The adjusted model uses features from which the effect of the "
            "confounder within a grade is subtracted, fitted by least squares in training.",
        ),
        table=pd.DataFrame(shown),
        note="The table shows the strongest association; all strengths, with p, are in confounders.csv. Age affects an "
        "image only through thinner trabeculae. Any other gain by age comes from variables associated with age and "
        "grade in this cohort, or from chance.",
        pictures=(picture,),
    )
