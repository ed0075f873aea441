"""What the results of a study depend on, beside the cohort."""

from dataclasses import dataclass, field

from ..core.checks import InputError, require, require_choice, require_seed, require_whole
from ..radiomics.backends import default_backend, require_backend
from ..radiomics.families import FAMILIES

# Name -> how it is written.
SELECTIONS = {"l1": "L1", "mrmr": "mRMR"}
MODELS = {"lr": "Logistic regression", "rf": "Random forest", "xgb": "XGBoost"}


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """What the results depend on, beside the cohort.

    region_px      side of the region about the medial joint line
    bins           of grey value, for texture
    repeats        splits of the subjects
    rho            |Spearman's rho| above which one of two features is left out, see `learn.selection.DropRedundant`
    most_features  that a selection may keep
    replicates     of the bootstraps of subjects: of trends, ICCs and films
    families       of features; one that is left out costs nothing
    selections     of SELECTIONS
    models         of MODELS
    difference     of AUC that the power to show it is given for
    strengths      of the tie of a confounder to grade: 0, which the others are held against, to 0.95
    reference      protocol of the within-protocol scenario, and that ICCs are paired with
    backend        what measures the features, of radiomics.backends.BACKENDS
    raises         InputError for a value out of range
    """

    region_px: int = 512
    bins: int = 64
    repeats: int = 10
    seed: int = 0
    rho: float = 0.9
    most_features: int = 10
    replicates: int = 2000
    families: tuple[str, ...] = FAMILIES
    selections: tuple[str, ...] = tuple(SELECTIONS)
    models: tuple[str, ...] = tuple(MODELS)
    difference: float = 0.05
    strengths: tuple[float, ...] = (0.0, 0.3, 0.6, 0.9)
    reference: str = "reference"
    backend: str = field(default_factory=default_backend)

    def __post_init__(self) -> None:
        require_whole("region_px", self.region_px, 16, 4096, "pixels")
        require_whole("bins", self.bins, 8, 256, "grey values")
        require_whole("repeats", self.repeats, 1, 1000, "splits")
        require_seed(self.seed)
        require_backend(self.backend)
        require("rho", self.rho, 0.1, 1, "(correlation)")
        require_whole("most_features", self.most_features, 1, 100, "features")
        require_whole("replicates", self.replicates, 100, 100_000, "samples")
        require("difference", self.difference, 0.001, 0.5, "(of AUC)")
        for strength in self.strengths:
            require("strengths", strength, 0, 0.95, "(of a tie)")
        if 0 not in self.strengths or len(set(self.strengths)) < len(self.strengths):
            raise InputError(f"strengths = {', '.join(map(str, self.strengths))}; allowed: 0 among them, each once")
        for name, allowed in (("families", FAMILIES), ("selections", SELECTIONS), ("models", MODELS)):
            given = getattr(self, name)
            if not given:
                raise InputError(f"{name} = (); allowed: one or more of {', '.join(allowed)}")
            for choice in given:
                require_choice(name, choice, tuple(allowed))
            if len(set(given)) < len(given):
                raise InputError(f"{name} = {', '.join(given)}; allowed: each once")
