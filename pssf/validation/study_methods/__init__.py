"""Validation of the study methods: localisation, interval coverage, random labels, ablation and feature backends."""
