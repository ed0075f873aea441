"""Texts of the comparison page: an introduction of each section and the captions of its tables."""

CONTOURS_TEXT = (
    "Sixteen contour landmarks of every simulated knee are compared with manual landmarks on 748 patient radiographs "
    "(PA, fixed flexion; Tiulpin et al. 2019). Coordinates are fractions of the plateau width, which removes size. A "
    "mean is inside its tolerance within half a standard deviation of the patient mean. A standard deviation is inside "
    "its tolerance at 0.7 to 1.4 times that of patients. Each simulated knee has one sampled acquisition under the "
    "protocol named above, or its radiographs in the given cohort."
)
BONES_TEXT = (
    "Bones without osteophytes are registered by a similarity transform (rotation, translation, scale). Distances are "
    "measured from surface to surface in both directions, at the mean size of the patient bones. The flat cut of the "
    "shafts is excluded. Spread is the distance of each bone from the mean of its group, measured in the same way."
)
FILMS_TEXT = (
    "Every radiograph, patient or simulated, is normalised: the joint is localised, left knees are mirrored, and the "
    "image is scaled to a plateau width of 78 mm, a pitch of 0.46 mm, a field of 92 by 77 mm, and 8 bits between the "
    "1st and 99th percentile. Simulated radiographs are first reduced to pixel sizes of the largest patient source. "
    "Bone contours are traced, and groups of features are measured. Models are logistic regressions (L2) on "
    "standardised features. Intervals are 95 % bootstrap intervals over subjects, with fixed models. They cover the "
    "choice of the tested radiographs only, and are wide if there are few radiographs."
)
CAPTIONS = {
    "domains": "(a) Source separability: AUC of patient against simulated radiographs, and between patient sources as "
    "a control. 0.5 means indistinguishable, 1 means always distinguished.",
    "transfer": "(b) Grade prediction on patient radiographs, trained on simulated radiographs (auc) and on patient "
    "radiographs by cross-validation (real_auc). way is the fraction of the gain over chance that training on "
    "simulated radiographs reaches. It is empty if the gain from patient radiographs is uncertain.",
    "effects": "(c) Standardised grade differences of patient and simulated radiographs, over the features of a group: "
    "correlation r and fraction of equal signs. most is the highest r that this number of radiographs can show.",
    "ratios": "(d) Outline ratios as fractions of the plateau width, for all radiographs of a patient source (given) "
    "and for simulated ones (drawn). A source with another view differs because of the view.",
    "tone": "(d) Grey values as displayed: contrasts, and tissue greys with soft tissue as 0 and shaft cortex as 1, "
    "where the image shows the shaft. Also the offset of the joint from the image centre in mm at the joint, which "
    "depends on cropping, and the mean grey about the joint.",
    "edges": "(d) Grey profile across the sides of the bones, at a depth in mm from the steepest point inwards; soft "
    "tissue is 0 and bone at 6 to 12 mm depth is 1. Also the strongest line on either side, divided by the spread of "
    "ridges.",
    "fine": "(d) Texture at the original pixel pitch, for pitches up to 0.25 mm.",
    "form": "(d) Texture of normalised radiographs, 0.2 to 0.8 cycles/mm.",
}
