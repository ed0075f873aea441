"""Radiomic features of a region: bone mask, shape, first-order and texture features, and feature tables."""
