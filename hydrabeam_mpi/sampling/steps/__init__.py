"""The steps of a sweep, each of which leaves the joint posterior as it is: one a file."""
