"""From a job file to everything that an inference needs besides the visibilities: sky, beams, array, prior."""
