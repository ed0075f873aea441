"""Posture: pose of the bones, joint space solver, flexion, plateau wear and plateau margins."""
