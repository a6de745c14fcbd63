"""What the loop found, in plain words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hydrabeam_mpi.words import capital, effect_words, joined

MOST_NAMED = 4
EACH_OF = {" at JD ": "times", " towards ra=": "directions"}
"""What in a parameter's name comes before one of many, and what these are."""
JUMP = ", jump"
QUESTIONS = "whether it is physical beside all others and the same in all parts of the data"
"""What an effect is asked when nothing more is found, and may be taken back for."""
GOES_ON = "The same command goes on from here."


def say_round(told: dict[str, Any]) -> str:
    """Tell a round in a few sentences: what, how sure, and what it changed."""
    named, more = _say_parameters(told)
    what = f"{capital(told['title'])}: {'; '.join(named)}{_say_others(more, len(told['parameters_not_told']))}"
    sure = f"log Bayes factor {told['log_bayes_factor']:,.0f}; the beam can absorb {told['absorbed_by_beam']:.0%} of it"
    error = f"Held-out reduced chi^2 {told['heldout_before']:.3g} -> {told['heldout_after']:.3g}"
    rms = f"rms {told['rms_before']:.3g} -> {told['rms_after']:.3g} Jy (noise {told['rms_noise']:.3g} Jy)"
    beam = f"the beam moves by up to {told['beam_change_max']:.1e}"
    doubt = [effect_words(one["effect"], one["law"]) for one in told["indistinguishable_from"]]
    unsure = f" These data do not tell it from {' or '.join(doubt)}." if doubt else ""
    added = "Added" if told["asked"] else f"Added, but not yet asked: {QUESTIONS}"
    added = "Added at first, but taken back since" if told["revoked"] else added
    added = "Added at first, and not claimed: it stays in the model for prediction" if told["predicts"] else added
    more_said = f"{_say_left_out(told)}{_say_widened(told)}{unsure}{_say_elsewhere(told)}"
    return f"{what} ({sure}). {added}. {error}; {rms}; {beam}.{more_said}"


def _say_others(more: int, not_told: int) -> str:
    """Count the parameters that are not named, and those that the data do not tell."""
    others = f"; and {more} more" if more > 0 else ""
    return f"{others}; and {not_told} that these data do not tell" if not_told > 0 else others


def _say_elsewhere(told: dict[str, Any]) -> str:
    """Tell where a part of the effect may be as well."""
    places = []
    for one in told["elsewhere"]:
        first = one["parameters"][0]["freq_hz"]
        of_first = [each for each in one["parameters"] if each["freq_hz"] == first]
        values = [f"{each['name'].partition(': ')[2]} {each['value']:.5g}{_unit(each)}" for each in of_first]
        places.append(f"{', '.join(values)} (ln likelihood {one['log_likelihood_ratio']:+.2g})")
    return f" These data do not tell it from another place: {'; or '.join(places)}." if places else ""


def _say_parameters(told: dict[str, Any]) -> tuple[list[str], int]:
    """Write down the most significant parameters, and count the others.

    What has a value of its own at each of several times, or in each of several directions, is told by how large it is
    over these.
    """
    groups: dict[tuple[str, str, Any], list[dict[str, Any]]] = {}
    for one in told["parameters"]:
        groups.setdefault((*_common_name(one["name"]), one["freq_hz"]), []).append(one)
    foremost = sorted(groups.items(), key=lambda group: -math.hypot(*map(_sigmas, group[1])))[:MOST_NAMED]
    named = [
        _say_over(head, each, ones) if len(ones) > 1 else say_parameter(ones[0]) for (head, each, _), ones in foremost
    ]
    return named, len(told["parameters"]) - sum(len(ones) for _, ones in foremost)


def _common_name(name: str) -> tuple[str, str]:
    """Return what a parameter shares with those of other times or directions, and what it is one of; else its name."""
    for before, each in EACH_OF.items():
        head, at, _ = name.partition(before)
        if at and not head.endswith(JUMP):
            return head, each
    return name, ""


def _say_over(head: str, each: str, ones: Sequence[dict[str, Any]]) -> str:
    """Write the name that values at several times, or in several directions, have in common, and their rms.

    One that has more of it than all others together, two or more, is named.
    """
    *others, largest = sorted(ones, key=lambda one: abs(one["value"]))
    of_others = math.hypot(*(one["value"] for one in others))
    rms = math.hypot(of_others, largest["value"]) / math.sqrt(len(ones))
    said = f"{head.removesuffix(',')} {rms:.3g}{_unit(ones[0])} rms over {len(ones)} {each}{_channel(ones[0])}"
    if len(others) < 2 or abs(largest["value"]) <= of_others:
        return said
    where = largest["name"].removeprefix(head).strip()
    return f"{said}, most of it {where} ({largest['value']:.4g} +- {largest['std']:.2g})"


def say_adapted(told: dict[str, Any]) -> str:
    """Tell in a sentence or two how the beam's prior was adapted, and what that changed."""
    when = f" after round {told['n_rounds']}" if told["n_rounds"] else ""
    sure, beyond = told["log_bayes_factor"], told["n_beyond"]
    widths = f"Widths of the beam's prior that the data want{when}: {told['words']}"
    said = f"{widths} (log Bayes factor {sure:,.0f} beside the stated ones). " if sure else ""
    if beyond:
        what = f"{beyond} function{'s' if beyond > 1 else ''} that none in its basis can follow"
        said += f"The beam got {what}{when} (log Bayes factor {told['log_bayes_factor_beyond']:,.0f}). "
    error = f"Held-out reduced chi^2 {told['predictive_chi2_before']:.3g} -> {told['predictive_chi2_after']:.3g}"
    rms = f"rms {told['rms_before']:.3g} -> {told['rms_after']:.3g} Jy (noise {told['rms_noise']:.3g} Jy)"
    return f"{said}{error}; {rms}."


def _say_left_out(told: dict[str, Any]) -> str:
    """Say where the rows are that are left out."""
    return f" {told['left_out']['sentence']}" if told["left_out"] else ""


def _say_widened(told: dict[str, Any]) -> str:
    """Say so where errors are larger than those by the noise alone."""
    widest = max(told["errors_widened_by"])
    if not widest > 1:
        return ""
    up_to = "up to " if min(told["errors_widened_by"]) < widest else ""
    return f" Errors are {up_to}{widest:.3g} times those by the noise alone, as more than noise is left of the data."


def say_parameter(one: dict[str, Any]) -> str:
    """Write name, value and error."""
    value, std = one["value"], one["std"]
    # To the second digit of the error, as places need many, and to four digits at least.
    digits = 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) if value and std > 0 else 4
    return f"{one['name']} {value:.{min(max(digits, 4), 15)}g} +- {std:.2g}{_unit(one)}{_channel(one)}"


def _unit(one: dict[str, Any]) -> str:
    return f" {one['unit']}" if one["unit"] else ""


def _channel(one: dict[str, Any]) -> str:
    return f" at {one['freq_hz'] / 1e6:.6g} MHz" if one["freq_hz"] is not None else ""


def _sigmas(one: dict[str, Any]) -> float:
    return float(one["sigma"] or 0.0)


def say_verdict(told: dict[str, Any]) -> str:
    """Tell how the loop ended, by what else ``loop.json`` has: verdict, errors, rounds, why, where and health."""
    odd = [f"{one['what']} ({one['where']})" for one in told["health"]]
    more = [f"{len(odd) - MOST_NAMED} more"] if len(odd) > MOST_NAMED else []
    of_data = f" Of the data themselves: {joined([*odd[:MOST_NAMED], *more])}." if odd else ""
    return f"{_verdict(told)}{of_data}"


def _verdict(told: dict[str, Any]) -> str:
    of_unknown = [one for one in still_there(told["rounds"]) if one.get("of_unknown")]
    names = _titles([one for one in still_there(told["rounds"]) if one not in of_unknown])
    lacked = f"The model lacked {joined(names)}"
    before = f"{told['error_before']:.4g} -> " if names or of_unknown else ""
    error = f"held-out reduced chi^2 {before}{told['error_after']:.4g}"
    match told["verdict"]:
        case "consistent":
            return f"Nothing is missing: the data agree with the model within the noise ({error})."
        case "interrupted":
            return f"Interrupted: what is left ({error}) was not looked at.{_not_confirmed(told)} {GOES_ON}"
        case "convention":
            conventions = told["conventions"]
            return (
                f"The data follow another convention than the one stated ({conventions['found']}): "
                f"{conventions['remedy']}. Nothing was fitted to it, and the inferred beam is not to be used."
            )
        case "explained":
            return f"{lacked}; with that added nothing significant is left ({error})."
    unknown = f"What is left ({error}) is explained by no effect in the catalogue."
    if names:
        unknown = f"{lacked}, and something else that no effect in the catalogue explains ({error})."
    if of_unknown:
        some = f"{lacked}, and some" if names else "Some"
        unknown = f"{some} of the data carry something that no effect in the catalogue explains ({error})."
    revoked = _titles([one for one in told["rounds"] if one.get("revoked") and not one.get("predicts")])
    gone = [f"What was added at first was taken back: {joined(revoked)}."] if revoked else []
    # Rounds that leave out data have the same sentence of where all of these are.
    where = [one["left_out"]["sentence"] for one in of_unknown[:1]]
    where += [told["where"]["sentence"]] if told["where"] else []
    return " ".join([unknown, *gone, *say_predicting(told), *_reasons(told), *where])


def still_there(rounds: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rounds whose effect has not been taken back since."""
    return [one for one in rounds if not one.get("revoked")]


def say_predicting(told: dict[str, Any]) -> list[str]:
    """Say what is in the model without being claimed, and how far what is claimed comes alone; nothing if all is."""
    titles = _titles([one for one in told["rounds"] if one.get("predicts")])
    alone = f"reduced chi^2 {told['error_claimed']:.4g} without"
    better = "not claimed, but in the model, which predicts held-out data better so"
    return [f"{capital(joined(titles))}: {better} ({alone})."] if titles else []


def _titles(rounds: Sequence[dict[str, Any]]) -> list[str]:
    """Name effects, each once."""
    return list(dict.fromkeys(one["title"] for one in rounds))


def _not_confirmed(told: dict[str, Any]) -> str:
    """Say what a loop that was ended had not come to: to ask what it had found, or to fit what it had weighed."""
    titles = _titles([one for one in told["rounds"] if one["effect"] in told["not_yet_asked"]])
    if titles:
        return f" Not yet asked of {joined(titles)}: {QUESTIONS}. None of it is confirmed."
    ranking = [one for one in told["last_ranking"] if one["log_bayes_factor"] > 0][:MOST_NAMED]
    if told["rounds"] or not ranking:
        return ""
    weighed = (
        f"{one['effect'].replace('_', ' ')} (log Bayes factor {one['log_bayes_factor']:,.0f})" for one in ranking
    )
    return f" Weighed, but not yet fitted: {joined(list(weighed))}."


def _reasons(told: dict[str, Any]) -> list[str]:
    """Say why data stay unexplained: a control model explains more than any effect, or predictions are off."""
    control, why = told["foreign"], told["why"]
    if control is None:
        return [f"{capital(_of_which_fit(told) + why)}."] if why else []
    return [
        f"{capital(control['title'])} would explain more than any of them (log Bayes factor "
        f"{control['log_bayes_factor']:,.0f}, held-out reduced chi^2 {control['heldout_after']:.4g})."
    ]


def _of_which_fit(told: dict[str, Any]) -> str:
    """Say of which fit the reasons are, where it is not the last one, whose numbers they would contradict."""
    if any(one.get("predicts") for one in told["rounds"]):
        return "with what is claimed alone, "
    return "before the beam's prior got its last widths, " if told["error_claimed"] != told["error_after"] else ""
