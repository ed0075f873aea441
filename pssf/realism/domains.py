"""Real against simulated: are they told apart, and does what is learnt carry over."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.impute import SimpleImputer
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from ..core.checks import Array
from ..study.statistics.metrics import auc, percentiles, weighted_auc
from .films import BETWEEN, TOLD, Record

Row = dict[str, Any]
ALL = "all"
FOLDS = 5
_FEWEST = 10  # films of either kind; with fewer, nothing is said
_STRENGTH = 0.1  # of the inverse penalty: some hundred features, some hundred films
_LEADING = 8
_NO_WAY: dict[str, float | None] = {"way": None, "way_low": None, "way_high": None}


@dataclass(frozen=True, kw_only=True, eq=False)
class Films:
    """Films of one source, measured.

    name      of the source
    features  (films, features) table; columns are (group, feature)
    grades    (films,) whole numbers, -1 where it is not known
    subjects  (films,) text; both knees of a person have one
    """

    name: str
    features: pd.DataFrame
    grades: NDArray[np.int64]
    subjects: NDArray[Any]

    def of_grades(self, grades: Sequence[int]) -> "Films":
        """Those of some grades."""
        here = np.isin(self.grades, grades)
        return Films(
            name=self.name, features=self.features[here], grades=self.grades[here], subjects=self.subjects[here]
        )


def learnable(name: str, records: Sequence[Record]) -> Films:
    """The films with a joint found, and the features that may be learnt from."""
    table = pd.DataFrame([record for record in records if record["status"] == "found"])
    columns = [name for name in table if BETWEEN in name and name.split(BETWEEN)[0] not in TOLD]
    features = table[columns].astype(float)
    features.columns = pd.MultiIndex.from_tuples([tuple(name.split(BETWEEN)) for name in columns])
    return Films(
        name=name,
        features=features.reset_index(drop=True),
        grades=table["grade"].fillna(-1).astype(int).to_numpy(),
        subjects=table["subject"].astype(str).to_numpy(),
    )


def told_apart(first: Films, second: Films, *, replicates: int, seed: int) -> list[Row]:
    """One row a group of features: AUC of one source against the other, by folds that share no subject.

    low, high  95 per cent interval of a bootstrap of subjects; the models are held
    leading    features that tell most by themselves, each with its AUC (0.5 or more)
    """
    table = pd.concat([first.features, second.features], ignore_index=True)
    truth = np.repeat([False, True], [len(first.features), len(second.features)])
    subjects = np.concatenate(
        [np.char.add("a:", first.subjects.astype(str)), np.char.add("b:", second.subjects.astype(str))]
    )
    rows = []
    for group, columns in groups_of(table).items():
        row = {"first": first.name, "second": second.name, "group": group, "features": len(columns)}
        row |= {"first_films": len(first.features), "second_films": len(second.features)}
        if _enough(truth, subjects):
            value = by_folds(table[columns], truth, subjects, seed)
            drawn = resampled_auc(truth, value, subjects, replicates=replicates, seed=seed)
            row |= _with_interval(truth, value, drawn)
            row["leading"] = "; ".join(f"{name} {one:.2f}" for name, one in leading(table[columns], truth))
        rows.append(row)
    return rows


def transferred(
    real: Films, simulated: Films, *, low: int, high: Sequence[int], replicates: int, seed: int
) -> list[Row]:
    """One row a group: AUC of grade `low` against `high` on real films, trained on simulated ones and on real ones.

    Simulated films of the highest grades that are drawn stand for those that are not.
    way  from chance to what real films teach, the share that simulated ones go; with a 95 per cent interval of the same
         subjects for both, and nothing where real films teach nothing that is sure
    """
    highest = [grade for grade in high if grade in simulated.grades] or [int(simulated.grades.max())]
    here, there = real.of_grades([low, *high]), simulated.of_grades([low, *highest])
    truth, known = here.grades != low, there.grades != low
    rows = []
    for group, columns in groups_of(real.features).items():
        row = {
            "source": real.name, "task": f"{low} v {'+'.join(map(str, high))}", "group": group,
            "trained_on": f"{low} v {'+'.join(map(str, highest))}", "real": len(truth), "simulated": len(known),
        }  # fmt: skip
        if _enough(truth, here.subjects) and min(np.bincount(known, minlength=2)) >= _FEWEST:
            carried = model(seed).fit(there.features[columns].to_numpy(), known)
            value = carried.predict_proba(here.features[columns].to_numpy())[:, 1]
            own = by_folds(here.features[columns], truth, here.subjects, seed)
            drawn, drawn_own = (
                resampled_auc(truth, one, here.subjects, replicates=replicates, seed=seed) for one in (value, own)
            )
            by_simulated, by_real = _with_interval(truth, value, drawn), _with_interval(truth, own, drawn_own)
            row |= by_simulated | {f"real_{name}": one for name, one in by_real.items()}
            row |= _way(truth, (value, own), (drawn, drawn_own)) if by_real["low"] > 0.5 else _NO_WAY
        rows.append(row)
    return rows


def _enough(truth: NDArray[np.bool_], subjects: NDArray[Any]) -> bool:
    """Whether there are films enough of either kind, and of people enough for each fold to have one of them."""
    kinds = [subjects[truth == kind] for kind in (False, True)]
    return all(len(of) >= _FEWEST and len(set(of.tolist())) >= FOLDS for of in kinds)


def groups_of(features: pd.DataFrame) -> dict[str, list[Any]]:
    """Group -> its columns; last, all of them."""
    names = dict.fromkeys(group for group, _ in features.columns)
    groups = {group: [column for column in features.columns if column[0] == group] for group in names}
    return {**groups, ALL: list(features.columns)}


def model(seed: int) -> Pipeline:
    """Logistic regression (L2) on standardised features."""
    return make_pipeline(
        SimpleImputer(strategy="median", keep_empty_features=True),
        StandardScaler(),
        LogisticRegression(C=_STRENGTH, max_iter=5000, random_state=seed, class_weight="balanced"),
    )


def by_folds(features: pd.DataFrame, truth: NDArray[np.bool_], subjects: NDArray[Any], seed: int) -> Array:
    """(films,) probability that each film is what `truth` says, by a model that saw no film of its subject.

    truth, subjects  (films,)
    """
    values, probability = features.to_numpy(), np.empty(len(truth))
    folds = StratifiedGroupKFold(FOLDS, shuffle=True, random_state=seed)
    for training, testing in folds.split(values, truth, subjects):
        probability[testing] = model(seed).fit(values[training], truth[training]).predict_proba(values[testing])[:, 1]
    return probability


def leading(features: pd.DataFrame, truth: NDArray[np.bool_]) -> list[tuple[str, float]]:
    """The features that tell most by themselves, with their AUC, turned so that it is 0.5 or more.

    truth  (films,)
    """
    alone = {}
    for column in features:
        values = features[column].to_numpy()
        value = auc(truth, np.nan_to_num(values, nan=np.nanmedian(values)))
        alone[" ".join(column)] = max(value, 1 - value)
    return sorted(alone.items(), key=lambda item: (-item[1], item[0]))[:_LEADING]


def _with_interval(truth: NDArray[np.bool_], value: Array, drawn: Array) -> dict[str, float]:
    """An AUC, and its interval from those of subjects drawn again."""
    low, high = percentiles(drawn)
    return {"auc": round(auc(truth, value), 4), "low": round(low, 4), "high": round(high, 4)}


def _way(truth: NDArray[np.bool_], values: tuple[Array, Array], drawn: tuple[Array, Array]) -> Mapping[str, float]:
    """How far the first of two AUCs is from 0.5, over how far the second is; drawn are those of the same subjects."""
    whole = [auc(truth, value) - 0.5 for value in values]
    beyond = drawn[1] - 0.5
    low, high = percentiles((drawn[0] - 0.5) / np.where(beyond > 0, beyond, np.nan))
    return {"way": round(whole[0] / whole[1], 3), "way_low": round(low, 3), "way_high": round(high, 3)}


def resampled_auc(
    truth: NDArray[np.bool_], value: Array, subjects: NDArray[Any], *, replicates: int, seed: int
) -> Array:
    """(replicates,) AUC on subjects drawn with replacement; those where one kind is missing are left out.

    truth, value, subjects  (films,)  value of any unit
    """
    rng = np.random.default_rng(seed)
    _, of_film = np.unique(subjects, return_inverse=True)
    times = np.column_stack([times_drawn(of_film, rng) for _ in range(replicates)])
    both = (times[truth].sum(axis=0) > 0) & (times[~truth].sum(axis=0) > 0)
    return weighted_auc(truth, value, times[:, both].astype(np.float64))


def times_drawn(of_film: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """(films,) how often each film is drawn where subjects are drawn with replacement, each with all its films.

    of_film  (films,) number of each film's subject, from 0
    """
    people = of_film.max() + 1
    return np.bincount(rng.integers(0, people, people), minlength=people)[of_film]
