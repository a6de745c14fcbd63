"""The numbers by which the search decides what is tried and kept. What data can decide is not among them.

Those by which single effects and checks tell what they look for stand beside these, each with its reason.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """What is tried, what a further element must add, and when two predictions count as different.

    Attributes
    ----------
    most_tries : int
        Effects that are fitted in one round at most. A fit costs as much as weighing all of them, and what comes
        seventh by its evidence has never come first once it was fitted.
    most_places : int
        Grating lobes at most in which a source is fitted, the highest ones first. Of antennas 14.6 m apart they are 8
        degrees apart at 150 MHz, so that twenty reach 20 degrees from the zenith, or the source, where a dish sees next
        to nothing.
    most_refits : int
        Times at most that an effect is fitted again with another prior, or with fewer elements. Widths change little
        after the second; the limit ends those that alternate.
    near, near_if_linear : float
        An effect with less than this fraction of the best one's ln evidence is not fitted beside it. A fit can raise
        the evidence of what is not linear, such as a source beside its place, several times; that of linear effects
        changes as far as the beam moves with them. Nothing is lost: what is left out is weighed again a round later. So
        it is with widths of the beam's prior, which gain some times what they promise. And several effects are fitted
        as one that together leave less than this fraction of what the best one leaves by itself.
    not_linear : float
        Fraction of all that a set explains below which its weakest may be what others have that is not linear: half
        the square of a phase of 0.1 rad is five thousandths. Such sets are fitted without these as well.
    most_columns : int
        Parameters at most, of all candidates, that are weighed together. The products of n columns take n^2 / 2 times
        as many sums as there are rows; six hundred take no longer than weighing each effect by itself.
    most_known : int
        Parameters at most of what is known beforehand, such as what the beams of all channels have in common. A fit
        with them takes as long as one with an effect of so many parameters.
    element_nats : float
        What a further element (an antenna, a source) must add to ln evidence beyond the price of picking it. Without a
        margin noise brings in one of dozens now and then; e^4 is one in fifty.
    decided_sigmas : float
        Standard errors beyond which held-out data have decided. By so much a gain in their ln density, or a loss, is
        more than a job asks for; else the held-out rows predict the fitted ones as well, and the sum decides. And by so
        much the rms of their residual has risen, paired over blocks of times or of groups, those that scatter more, by
        differences or by ranks. One would be a sixth of all that is neither better nor worse, and refuses parts of the
        beam that the data want; more would cost time where the answer is clear.
    no_worse : float
        Nats by which held-out data may be less likely with other widths of the beam's prior, where these have the
        evidence of the fitted data: odds of less than e to one are not worth a mention (Kass and Raftery 1995).
    first_step : float
        Part of a step with which a fit that got stuck is begun again, with damped steps. Those that succeed are
        doubled, so that a sixteenth costs four steps more where a whole one would do.
    """

    most_tries: int = 6
    most_places: int = 20
    most_refits: int = 3
    most_columns: int = 600
    most_known: int = 512
    near: float = 0.1
    near_if_linear: float = 0.7
    not_linear: float = 0.005
    element_nats: float = 4.0
    decided_sigmas: float = 2.0
    no_worse: float = 1.0
    first_step: float = 0.0625


RULES = Rules()
