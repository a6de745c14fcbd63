"""Which effect is tried, accepted and kept, round after round.

A loop (`search`) begins with what is known (`first_and_last`) and goes through rounds (`rounds`) until nothing more is
found. In a round

1. all effects are weighed, each by itself and all together (`weighing`);
2. a set that explains the residual is fitted as a whole (`whole_set`), or effects one by one (`trials`), each as far as
   it promises anything (`candidate_fits`, `foremost`, `physical`);
3. the best is accepted unless something speaks against it (`acceptance`, `refusal`, by `heldout_score` and `folds`);
4. what was found before is weighed again beside it (`revision`).

Where nothing more is found effects give their place to better ones (`exchange`) or simpler ones (`simpler`), what is
faint or not the same in all parts of the data goes (`taken_back`), and the beam's prior gets the widths that the data
want (`prior_widths`, `beyond_basis`, `freer_beam`). What cannot be claimed may stay for prediction (`for_prediction`).
"""
