"""Checks outside the joint fit: conventions, and leakage in the cross-polarisations."""
