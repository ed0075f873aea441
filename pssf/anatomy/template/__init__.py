"""Template anatomy: mean femur and tibia, shape model, and deformation of the template bones into those of one knee."""
