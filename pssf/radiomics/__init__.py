"""Radiomics: find the knee joint in a radiograph, cut out a region, and measure its features; needs the extra `study`.

radiomics_tables          settings and feature tags that localisation and measurement need
displayed_radiograph      measurement of displayed radiographs, which have any pixel size and grey scale
localisation
  joint_localisation      the medial joint line, with side, orientation, polarity and pixel size
  pixel_aspect            the same in images whose pixels may not be square
  template_matching, joint_candidates, templates, edge_field
                          correlation of edges with those of template radiographs
  laterality              evidence for a right or left knee
  second_knee             whether the other knee is on the radiograph too
  crop_template           templates reduced to the part that localisation reads
  region_of_interest      the square region about the joint line
features
  feature_extraction      features of a region, by name
  feature_table           one record of features per radiograph
  feature_families        families of features
  feature_backends        choice between pyradiomics and MIRP; pyradiomics_backend, mirp_backend: each of them
  bone_mask, shape2d      segmentation of the bone, and its shape
  mask_overlap            agreement of a segmented mask with the true one
  texture_measures        power spectrum and grey values of trabecular bone
  ibsi_tags               correspondence with the features of the IBSI
  image_processing        processing of the grey values, in words
"""

from .features.feature_families import FAMILIES

__all__ = ["FAMILIES"]
