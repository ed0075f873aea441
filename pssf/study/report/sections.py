"""Parts of the report that are sentences, pictures and a printed table; the page lays them out alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from ..design import Axis
from ..learn.confounders import CONFOUNDERS
from ..learn.ladder import READING_SD_MM, RUNGS
from ..space import SPACE
from ..statistics.ladder import CEILING
from ..statistics.learning import WANTED
from . import ladder_figures, response_figures
from .page import Picture, fixed, signed


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the report.

    name      of its place in the page
    short     what the list of sections calls it
    table     cells as they are printed, under column names as they are printed; empty: none
    note      below the table
    """

    name: str
    short: str
    title: str
    sentences: Sequence[str]
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    note: str = ""
    pictures: Sequence[Picture] = ()


def segmentation_section(table: pd.DataFrame) -> list[Section]:
    """How the bone that shape is measured of agrees with the bone that there is; nothing where that is not known.

    table  of `segmentation.segmentation`
    """
    if table.empty:
        return []
    shown = [
        {
            "Grade": row["grade"],
            "Radiographs": row["radiographs"],
            "Dice": fixed(row["dice"]),
            "Dice, 5th pct": fixed(row["dice_p5"]),
            "Outlines apart, mean, mm": fixed(row["mean_mm"]),
            "95th pct, mm": fixed(row["p95_mm"]),
            "Area found / true": fixed(row["area"]),
        }
        for row in table.to_dict("records")
    ]
    return [
        Section(
            name="bone",
            short="Bone",
            title="The bone that is found, and the bone that there is",
            sentences=(
                "Shape is measured of what attenuates more than the soft tissue of its column. Here that is held "
                "against the projection of all bones, osteophytes with them, in the regions of the knees taken again. "
                "Where they differ much, a shape feature is a measure of where the signal falls below a threshold, and "
                "not of an outline of bone.",
            ),
            table=pd.DataFrame(shown),
            note="Distances are between the outlines, both ways, at the joint plane. segmentation.csv has all numbers.",
        )
    ]


def ladder_section(rungs: pd.DataFrame, differences: pd.DataFrame, subjects: int) -> Section:
    """What a grade can be told by.

    rungs, differences  as for `ladder_figures.ladder`
    subjects            of the cohort
    """
    picture = Picture(
        name="ladder",
        png=ladder_figures.ladder(rungs, differences),
        alt="AUC of grade 0 against each other grade by what is known of a knee, and paired differences",
        caption="AUC by what logistic regression knows, mean over the splits, and 95 % intervals; dashed: possible, at "
        "least, from all parameters of newly drawn knees. Below: paired differences on the same splits.",
    )
    shown = [
        {
            "Question": row["question"],
            "Grades": row["grades"],
            "Difference of AUC": signed(row["difference"]),
            "95 %": f"{signed(row['low'])} to {signed(row['high'])}",
            "p, Holm": fixed(row["p_holm"], 3),
            "Answer": row["answer"],
        }
        for row in differences.to_dict("records")
    ]
    best = rungs[rungs["rung"] == CEILING]
    drawn = f" ({int(best['knees'].iloc[0])} knees each, held-out fifths)" if len(best) else ""
    return Section(
        name="ladder",
        short="Ladder",
        title="What a grade can be told by",
        sentences=(
            "The same splits and the same model, logistic regression, with more or less known: "
            f"{', '.join(RUNGS.values())}. A measured joint space is the true one with the error of a reading, "
            f"{READING_SD_MM} mm (Mazzuca 1999), in each compartment; it stands beside features whatever is selected. "
            "No image can tell more than all that a knee is built with, but for its texture, which tells at least "
            f"what a fit to knees drawn anew does{drawn}. Where a rung of true parameters lies below it, "
            f"{subjects} subjects are too few to learn it from.",
        ),
        table=pd.DataFrame(shown),
        note="Yes and no: the corrected p is below 0.05, and splits test enough subjects; no means worse. "
        "ladder.csv and ladder_differences.csv have all numbers.",
        pictures=(picture,),
    )


def learning_section(curves: pd.DataFrame, power: pd.DataFrame) -> Section:
    """How many patients are needed.

    curves, power  of `statistics.learning`
    """
    picture = Picture(
        name="learning",
        png=ladder_figures.learning(curves, power),
        alt="AUC against the number of subjects learnt from, and power against the size of a cohort, by pair of grades",
        caption="Above: AUC against the subjects learnt from; the tested subjects of a split are the same for all, so "
        "that what changes is learning alone. Below: power to show the chosen difference from the measured joint space "
        "against the subjects of a cohort; a dot is this one, the band from the interval of the splits' variance.",
    )
    shown = [
        {
            "Question": row["question"],
            "Grades": row["grades"],
            "Subjects here": row["subjects"],
            "Power here": fixed(row["power"]),
            f"Subjects for a power of {WANTED}": f"{row['needed']:.0f}",
            "95 %": f"{row['needed_low']:.0f} to {row['needed_high']:.0f}",
        }
        for row in power.to_dict("records")
    ]
    chosen = f"{power['difference'].iloc[0]:g}" if len(power) else "the chosen size"
    return Section(
        name="learning",
        short="How many",
        title="How many patients",
        sentences=(
            "What a classifier would gain by more subjects to learn from, and what a cohort of another size could "
            f"show: the power to find a difference of AUC of {chosen} at 5 %, two-sided, by the paired test of this "
            "report. The variance of a difference is taken to fall as 1 over the subjects.",
        ),
        table=pd.DataFrame(shown),
        note="Subjects are of the two grades together, training, validation and test. learning.csv has every step's "
        "gain with its interval, power.csv the errors.",
        pictures=(picture,),
    )


def curves_section(
    tables: Mapping[str, pd.DataFrame],
    breaks: pd.DataFrame,
    axes: Mapping[str, Axis],
    leading: Sequence[str],
    knees: int,
    task: str,
) -> Section:
    """What becomes of features and models along the axes of `design`.

    tables   "curve_<axis>" -> rows of `statistics.responses`
    breaks   of `statistics.breaks`
    leading  features that are drawn one by one
    knees    with curves, of the grades of a task
    """
    pictures = [
        Picture(
            name=f"curve_{name}",
            png=response_figures.response(tables[f"curve_{name}"], breaks[breaks["axis"] == name], axis, leading, task),
            alt=f"Change of features, their ICC, threshold shift and AUC against {axis.label}",
            caption=f"{axis.label[0].upper()}{axis.label[1:]}: change of the features that models lean on most, their "
            "ICC(2,1) with the cohort's own radiographs, the log odds by which a threshold would have to move, and "
            "AUC. Orange: where the conclusion of the table breaks, with its interval; dotted: the protocol's own.",
        )
        for name, axis in axes.items()
    ]
    shown = [
        {
            "Axis": row["axis"].replace("_", " "),
            "Conclusion": row["conclusion"],
            "Breaks": row["reading"],
            "Measured": f"{row['from']:.3g} to {row['to']:.3g}",
        }
        for row in breaks.to_dict("records")
    ]
    return Section(
        name="curves",
        short="Curves",
        title="Response curves",
        sentences=(
            f"{knees} knees, of grade {task}, taken again with one thing of the protocol changed at a time, each time "
            "with noise of its own. Models are those of the first selection, learnt under the protocol as it is, "
            "tested on half of these knees, which they have not seen, in every split.",
            "A conclusion is followed from the protocol's own step outwards to where it first breaks. Intervals of a "
            "median ICC are of samples of the knees; of a loss of AUC, where the ends of its interval cross.",
        ),
        table=pd.DataFrame(shown),
        note="curve_<axis>.csv has every feature at every step, breaks.csv the places.",
        pictures=pictures,
    )


def meaning_section(
    shares: pd.DataFrame, follows: pd.DataFrame, leading: Sequence[str], bounds: Mapping[str, tuple[float, float]]
) -> Section:
    """What features measure.

    shares   of `statistics.space.shares`
    follows  of `statistics.space.beside`
    leading  features that models lean on most
    bounds   of `space.bounds_of`
    """
    picture = Picture(
        name="meaning",
        png=response_figures.meaning(shares, follows, leading),
        alt="Total share of variance by group of parameters of the leading features; slopes against correlations",
        caption="Of the features that models lean on most. Left: the total share of variance that a group of "
        "parameters has, alone and with others (Sobol 1993). Right: slope with the noise held against correlation over "
        "the cohort, a point a feature and parameter, the leading ones in colour; the line is where both are the same.",
    )
    part = follows[follows["feature"].isin(leading)].dropna(subset="slope")
    strongest = part.assign(size=part["slope"].abs()).sort_values("size", ascending=False, kind="stable")
    shown = [
        {
            "Feature": row["feature"],
            "Parameter": row["parameter"],
            "Slope, SD a SD": signed(row["slope"]),
            "95 %": f"{signed(row['slope_low'])} to {signed(row['slope_high'])}",
            "Correlation": signed(row["rho"]),
            "Within a grade": signed(row["rho_within"]),
        }
        for row in strongest.groupby("feature", sort=False).head(2).to_dict("records")
    ]
    spans = "; ".join(f"{SPACE[name].label} {low:.3g} to {high:.3g}" for name, (low, high) in bounds.items())
    samples = f" of {int(shares['samples'].max())} samples" if len(shares) else ""
    return Section(
        name="meaning",
        short="Meaning",
        title="What a feature measures",
        sentences=(
            f"Shares of variance{samples} over the space of the knee's and the protocol's parameters, by SALib with "
            "95 % intervals; and what a feature does when one parameter of a knee is changed by a tenth of its span "
            "while everything else, the noise too, is held. A correlation over a cohort holds what grades "
            "tie together.",
            f"The space: {spans}.",
        ),
        table=pd.DataFrame(shown),
        note="The two strongest slopes of each leading feature. follows.csv has all, with correlations beside them, "
        "shares.csv first-order and total shares.",
        pictures=(picture,),
    )


def confounders_section(table: pd.DataFrame) -> Section:
    """What confounders do.

    table  of `statistics.confounders.confounding`
    """
    picture = Picture(
        name="confounders",
        png=ladder_figures.confounders(table),
        alt="AUC against the strength by which age, BMI or site goes with grade, naive and adjusted",
        caption="AUC of grade 0 against 2 by the strength of the tie, mean over the splits with its 95 % interval: of "
        "a naive model where the tested are tied as the learnt from, and where they are not; of an adjusted one there.",
    )
    strongest = table[table["strength"] == table["strength"].max()]
    shown = [
        {
            "Confounder": CONFOUNDERS[row["confounder"]],
            "Strength": f"{row['strength']:g}",
            "Measure": row["measure"],
            "AUC": fixed(row["value"]),
            "95 %": f"{fixed(row['low'])} to {fixed(row['high'])}",
        }
        for row in strongest.to_dict("records")
    ]
    return Section(
        name="confounders",
        short="Confounders",
        title="Confounders by design",
        sentences=(
            "Of a strength s, a share (1 + s)/2 of the learnt-from subjects of grade 2 are above the median age or "
            "BMI, or taken under the second protocol, and as many of grade 0 below it or under the reference; as many "
            "subjects whatever s. Tested subjects are weighted so that the tie is there or is not. Adjusted: each "
            "feature less what it follows of the confounder at a given grade, by least squares in training.",
        ),
        table=pd.DataFrame(shown),
        note="The strongest tie; confounders.csv has all, with p. Of age an image shows thinner trabeculae alone: what "
        "else a model gains by it comes by way of what goes with age and grade in this cohort, or is chance.",
        pictures=(picture,),
    )
