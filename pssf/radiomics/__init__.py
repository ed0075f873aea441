"""From a radiograph to numbers; needs the extra `study`.

families.family       feature               -> its family, one of FAMILIES
tables                the package's tables  -> what finding and measuring read, as one record
locate.find_joint     pixels, templates     -> medial joint line of a radiograph of known side and pitch, or why not
locate.locate         film, templates       -> the same of any film, with side, way up, polarity and pitch
second_knee           joint, pixels         -> whether the other knee is on the radiograph too
aspect.locate_film    film, templates       -> the same where pixels may be higher than wide, as of resized crops
search, patches, edges  correlation, what is looked for, and what both are seen as
region.cut_region     pixels, row, col      -> region (size, size)
bone.bone_mask        region, pixel_mm      -> mask of bone (size, size), by a watershed of the gradient
overlap.overlap       masks                 -> Dice coefficient, distance of outlines
processing.processing   settings            -> what is done to grey values, in words
features.extract      region, pixel_mm      -> feature name -> value, by pyradiomics or MIRP
backends              which of them is taken; by_pyradiomics, by_mirp: what each measures; shape2d: what MIRP lacks
ibsi.tag_of           feature               -> which feature of the IBSI it is; departure_of: how it departs
display.measure_display  job, film           -> record of a radiograph as displayed, brought to a pitch and a tone
texture.texture       patch, pixel_mm       -> slopes of its spectrum, direction of its lines, grey values
compact.compact       template              -> what localisation reads of it
table.extract_all     jobs, how to load     -> one record a radiograph, in the order of the jobs
"""

from .families import FAMILIES

__all__ = ["FAMILIES"]
