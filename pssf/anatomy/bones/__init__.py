"""Bones of a knee: shells of femur and tibia, small bones, osteophytes, wear, and checks of their solids."""
