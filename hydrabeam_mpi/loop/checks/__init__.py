"""What is looked for by itself: conventions, and leakage in the cross-polarisations."""
