"""Settings of the study."""

import pytest

from pssf.core.checks import InputError
from pssf.study.design.study_settings import StudySettings


@pytest.mark.parametrize(
    "wrong",
    [
        *({"rho": 2}, {"models": ("svm",)}, {"selections": ()}, {"repeats": 0}, {"bins": 7.5}),
        *({"strengths": (0.0, 1.0)}, {"strengths": (0.3, 0.6)}, {"strengths": (0.0, 0.3, 0.3)}, {"strengths": ()}),
    ],
)
def test_settings_out_of_range_raise_an_error(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        StudySettings(**wrong)
