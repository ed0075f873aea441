"""Template anatomy: mean femur and tibia, shape model, and their deformation into the bones of one knee."""
