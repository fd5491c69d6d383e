"""Ranks the sources of a fleet for its target, and says which experience will help it."""

import nufleet

found = nufleet.rank("paper_linear")
for place, source in enumerate(found.ranking, start=1):
    verdict = found.verdicts[source.robot]
    print(f"{place}. {source.robot}: ψ* {source.psi:.3f}, {verdict.verdict}")
print(f"take {found.selected}'s experience; the run is kept in {found.run}")
again = nufleet.load_run(found.run)
print(again.headline)
