"""Radiomics: localise the knee joint in a radiograph, cut out a region and measure features.

This subpackage requires the optional dependencies `study`.

radiomics_tables          localisation settings and IBSI tags
displayed_radiograph      measurement of displayed radiographs of any pixel size and grey scale
localisation
  joint_localisation      position of the medial joint line, side, orientation, polarity and pixel size
  pixel_aspect            joint localisation in images whose pixels may not be square
  template_matching, joint_candidates, templates, edge_field
                          correlation of image edges with the edges of template radiographs
  laterality              evidence for a right or left knee
  second_knee             detection of the other knee on the same radiograph
  crop_template           cropping of templates to the area that localisation uses
  region_of_interest      square region around the medial joint line
  region_placement        position of the region by the reader, or by the true labels
features
  feature_extraction      measurement of the features of a region
  feature_table           measurement of many radiographs, with one feature record per radiograph
  feature_families        names of the feature families
  feature_backends        selection of a feature library
  pyradiomics_backend, mirp_backend
                          feature measurement by pyradiomics and by MIRP
  bone_mask, shape2d      segmentation of the bone, and shape features of a mask
  mask_overlap            agreement of a segmented mask with the true mask
  texture_measures        power-spectrum and grey-value features of trabecular bone
  ibsi_tags               tags of features in the IBSI reference manual
  image_processing        description of the grey-value processing for reports
"""

from .features.feature_families import FAMILIES

__all__ = ["FAMILIES"]
