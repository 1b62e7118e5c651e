"""What was looked at before a measurement is believed."""

from __future__ import annotations

from irpmd_rig.report.content import Check, Verdict
from irpmd_rig.report.reading import Content, Run
from irpmd_rig.report.wording import days_between, listed, number
from irpmd_rig.store.states import ENDED_BADLY


def ended_badly(run: Run) -> Verdict | None:
    """The verdict on a run that failed, was aborted or interrupted; None if it did not."""
    state = run.state
    if state is None or state.state not in ENDED_BADLY:
        return None
    reason = "" if state.reason is None else f": {state.reason}"
    return Verdict(False, f"This run is {state.state}{reason}", state.detail)


def measurement_checks(run: Run) -> tuple[Check, ...]:
    """Checks of a measurement: those that its result tells of, or what follows from it."""
    content = run.content or {}
    own = (*_frames(content), _positions(content))
    if "checks" in content:
        return (*own, *(Check(check["name"], check["passed"], check["says"]) for check in content["checks"]))
    return (*own, _calibration(run), *_facets(content))


def summed_up(checks: tuple[Check, ...]) -> tuple[bool | None, str]:
    """Whether all were found good, and that in words."""
    bad = [check.name for check in checks if check.passed is False]
    good = sum(check.passed is True for check in checks)
    if bad:
        return False, f"{len(bad)} of {len(checks)} checks not passed: {'; '.join(bad)}."
    if not good:
        return None, ""
    open_ = len(checks) - good
    rest = f", {open_} could not be made" if open_ else ""
    return True, f"All {good} checks passed{rest}." if not rest else f"{good} checks passed{rest}."


def _frames(content: Content) -> tuple[Check, ...]:
    """Frames were checked when taken or when computed; a run whose frames fail has no result."""
    found = []
    for position in content.get("positions", []):
        checks = position.get("checks") or position
        notes = checks.get("notes") or []
        told = [f"checked {position.get('checked', '')}".strip()]
        if checks.get("noise_dn") is not None:
            told.append(f"noise {number(checks['noise_dn'])} DN")
        if isinstance(checks.get("modulation_dn"), list):
            told.append(f"modulation {listed(checks['modulation_dn'], 3)} DN")
        name = f"Frames at {position['stage1_mm']:.4g} mm fresh, in order, not saturated"
        found.append(Check(name, True if position.get("checked") else None, ", ".join([*told, *notes])))
    return tuple(found)


def _positions(content: Content) -> Check:
    positions = content.get("positions", [])
    measured = bool(positions) and all(position.get("stage1_measured") for position in positions)
    where = ", ".join(f"{position['stage1_mm']:.4f}" for position in positions)
    told = f"{where} mm" if measured else f"{where} mm commanded; the stage does not tell where it is"
    by_glass = [position.get("stage1_by_the_glass_mm") for position in positions]
    if by_glass and None not in by_glass:
        told += f"; by the glass seen in the same frames {', '.join(f'{mm:.4f}' for mm in by_glass)} mm"
    return Check("Stage positions read back", measured or None, told)


def _calibration(run: Run) -> Check:
    """What is used was checked before anything moved: one that does not fit is refused."""
    content = run.content or {}
    geometry = run.used.get("calibrate-geometry")
    age = None if geometry is None else days_between(geometry.get("created"), content.get("created"))
    limits = run.record.rig.get("calibration")
    limit = limits.get("max_age_days") if isinstance(limits, dict) else None
    told = f"camera {content.get('camera_serial') or 'not known'}"
    if age is not None:
        allowed = f", {limit:g} allowed" if isinstance(limit, int | float) else ""
        told += f"; taken {age:.2f} days before{allowed}"
    return Check("Calibrations and reference belong to this camera and to each other", True, told)


def _facets(content: Content) -> tuple[Check, ...]:
    facets = content.get("facets") or []
    if not facets:
        return (Check("Facets found", False, content.get("without_steps") or "none"),)
    curved = [str(facet["facet"]) for facet in facets if not facet.get("flat", True)]
    told = f"{len(facets)} found"
    if curved:
        return (Check("Facets flat", None, f"{told}; curved: {', '.join(curved)}"),)
    return (Check("Facets flat", True, f"{told}; no more shape is left in any than a pixel's noise, or 20 µm"),)
