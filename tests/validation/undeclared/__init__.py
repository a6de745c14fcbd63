"""Data with an effect that the package is not told of, made by code that shares nothing with the package.

matvis computes the visibilities; everything that goes wrong with them is done here. Nothing in this package but
`score` and the tests knows that `hydrabeam_mpi` exists, and they only run its command and read what it wrote.

- `setting`: array, times, channels and sky, drawn by a seed; `beams`: the beam of the sky and the one of the job.
- `truth`: what is so and what the job believes; `simulator`: visibilities of it, by matvis.
- `gains`, `coupling`, `closure`, `skies`, `geometry`, `beam_errors`, `polarisation`, `noise`, `in_time`, `conventions`,
  `unknown`, `absorbed`, `faults`, `strange`: what may be wrong, by family.
- `cases`: the list of all; `detect`: whether the data can show it; `generate`: the files; `score`: the verdict.
"""
