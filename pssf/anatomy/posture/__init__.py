"""Posture: pose of the bones, joint space solver, flexion, wear and plateau margins."""
