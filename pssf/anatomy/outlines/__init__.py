"""Projected outlines of femur and tibia: contour landmarks and the joint space between the two contours."""
