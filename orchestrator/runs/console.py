"""Prints the progress of a study on stderr, and the tables at its end."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from nufleet.orchestrator.runs.rank_result import ClosedForm, RunRecord
from nufleet.orchestrator.study.interface import Question, Report, SourceEstimate
from nufleet.orchestrator.study.outcomes import Measured, TestOutcome
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.robots.spec import RobotSpec


class ConsoleObserver:
    """Prints the tests of each round, the ranking after it, and its confidence."""

    def __init__(
        self, console: Console, iterations: int, specs: Mapping[str, RobotSpec] | None = None
    ) -> None:
        """Print on a console; with the specs of the robots, also how long and how far they move."""
        self._console = console
        self._iterations = iterations
        self._specs = specs or {}
        self._dropped: set[str] = set()
        self._eliminated: set[str] = set()

    def asked(self, question: Question) -> None:
        """Print the tests that the robots are asked to play now; they may refuse."""
        played = question.omega_rad_s
        tones = ", ".join(f"{omega:.3f}" for omega in played)
        if len(played) > 3:
            tones = f"{len(played)} tones from {played[0]:.3f} to {played[-1]:.3f}"
        count = len(question.robots)
        robots = "1 robot is" if count == 1 else f"{count} robots are"
        self._console.print(
            f"[bold]iteration {question.iteration}/{self._iterations}[/]  "
            f"{robots} asked to play {tones} rad/s{self._motion(question)}{_price(question)}"
        )

    def _motion(self, question: Question) -> str:
        """Return how long the robots move and within which bounds, where their specs are known."""
        tested = [(test, self._specs[r]) for r, test in question.tests.items() if r in self._specs]
        if not tested:
            return ""
        longest_s = max(duration_s(test, spec) for test, spec in tested)
        axes = [(one, spec.axis(one.axis)) for test, spec in tested for one in test.played]
        reach = [(played.amplitude or axis.amplitude_max, axis.unit) for played, axis in axes]
        furthest, unit = max(reach)
        return f", {longest_s:.0f} s long and within ±{furthest:.4g} {unit}"

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Print that a test has to be repeated or given up."""
        self._console.print(f"  [yellow]{robot}, attempt {attempt}: {reason}[/]")

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Print what the study learned in the round."""
        for robot, reason in report.dropped.items():
            if robot not in self._dropped:
                self._dropped.add(robot)
                self._console.print(f"  [red]continuing without {robot}: {reason}[/]")
        for outcome in outcomes.values():
            if isinstance(outcome, Measured):
                for warning in outcome.response.quality.warnings:
                    self._console.print(f"  [yellow]{outcome.robot}: {warning}[/]")
        self._print_ranking(report)
        self._print_confidence(report)

    def _print_confidence(self, report: Report) -> None:
        for robot, reason in report.eliminated.items():
            if robot not in self._eliminated:
                self._eliminated.add(robot)
                self._console.print(f"  {robot} is no longer tested: {reason}")
        for finding in report.findings:
            self._console.print(f"  [yellow]{finding}[/]")
        if report.confidence is not None:
            self._console.print(f"  probability of a correct selection: {report.confidence:.3f}")
        if report.stopped_because is not None:
            self._console.print(f"  done: {report.stopped_because}")

    def _print_ranking(self, report: Report) -> None:
        for estimate in report.ranking:
            sample = report.sampled_psi.get(estimate.robot)
            measured = "" if sample is None else f"ψ = {sample:.4f}"
            leader = "  [green]← closest[/]" if estimate.robot == report.selected else ""
            self._console.print(
                f"  {estimate.robot:<16} {measured:<12}  "
                f"ψ* = {estimate.stated} "
                f"at {estimate.omega_rad_s:.3f} rad/s{estimate.on_axis}{leader}"
            )


def _price(question: Question) -> str:
    """Return what a round costs and is for, in words."""
    if question.robot_time_s is None:
        return ""
    return f"; {question.robot_time_s:.0f} robot-seconds: {question.purpose}"


def record_table(record: RunRecord) -> Table:
    """Return the final table of a ranking.

    The adaptive algorithm stops as soon as the choice is sure, and its interval covers frequencies
    that it did not test. Only the paper's algorithm, which estimates ψ* itself to the end, is
    compared with the closed form.
    """
    exact = record.closed_form if record.result.confidence is None else {}
    return ranking_table(record.result.ranking, exact)


def ranking_table(
    ranking: tuple[SourceEstimate, ...], closed_form: Mapping[str, ClosedForm]
) -> Table:
    """Return a table of estimates.

    Args:
        ranking: Estimates, best first.
        closed_form: True distances, by source, where robots know their models.
    """
    table = Table(title="worst-case chordal distance to the target", title_justify="left")
    table.add_column("source", no_wrap=True)
    exact_headings = ("closed form", "error") if closed_form else ("tests",)
    axes = list(ranking[0].axes or {}) if ranking else []
    decides = (*(f"ψ* on {axis}" for axis in axes), "decided by") if axes else ()
    for heading in ("ψ*", "95 % interval", *decides, "measured, at rad/s", *exact_headings):
        table.add_column(heading, justify="right")
    for place, estimate in enumerate(ranking):
        interval = f"{estimate.psi_low:.4f}–{estimate.psi_high:.4f}"
        row = [estimate.robot, f"{estimate.psi:.4f}", interval]
        if estimate.axes is not None and estimate.axis is not None:
            row += [f"{one.psi:.4f}" for one in estimate.axes.values()]
            row.append(estimate.axis)
        row.append(estimate.measured)
        exact = closed_form.get(estimate.robot)
        if not closed_form:
            row.append(str(estimate.tests))
        elif exact is None:
            row += ["", ""]
        elif exact.psi == 0:  # a twin of the target: no error is relative to nothing
            row += ["0.0000", ""]
        else:
            row += [f"{exact.psi:.4f}", f"{100 * (estimate.psi / exact.psi - 1):+.2f} %"]
        table.add_row(*row, style="bold green" if place == 0 else None)
    return table
