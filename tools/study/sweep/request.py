"""What is asked of a campaign, by `pcpc sweep` or `pcpc.sweep`, and the work that follows."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.study.sweep.campaign import SEARCHES, Campaign, Shard
from pcpc.tools.study.sweep.numbers import MOST, check_whole
from pcpc.tools.study.sweep.search import Search
from pcpc.tools.study.sweep.vary import grid_size, parse_variations
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.arguments import MOST_SEED

DRAWS = 1000


@dataclass(frozen=True)
class Request:
    """The words are those of `pcpc.sweep`; `vary`, `settings`, `shard` are texts of options."""

    rig: str
    controllers: Sequence[str] = ()
    vary: Sequence[str] = ()
    settings: Sequence[str] = ()
    draws: int | None = None
    sampling: str | None = None
    seed: int = 1
    until: str | None = None
    worst: int | None = None
    rare: int | None = None
    of: str | None = None
    limit: float | None = None
    shard: str | None = None
    threads: int | None = None
    scheduler: str | None = None

    def campaign(self) -> Campaign:
        """Return it completed; RigError for what contradicts itself, or no run can have."""
        names, given = tuple(self.controllers), ",".join(self.controllers)
        sampling, draws = self._search() or (self.sampling, self.draws)
        if "" in names:
            what = "expected names with a comma between, as pid,pd"
            raise RigError(f"--controllers {given!r}: {what}")
        if twice := [name for i, name in enumerate(names) if name in names[:i]]:
            raise RigError(f"--controllers {given}: {twice[0]} is there twice")
        names = names or (load_rig(self.rig, None, self.settings).config.controller,)
        until = self.until is not None
        sampling = sampling or ("random" if until or not self.vary else "sobol")
        if until and sampling != "random":
            what = f"--until counts independent draws, and --sampling {sampling} makes others"
            raise RigError(f"{what}; leave --sampling out")
        if draws is None and sampling == "grid":
            draws = grid_size(parse_variations(self.vary))
        if draws is None:
            draws = MOST if until else DRAWS
        check_whole(sampling if sampling in SEARCHES else "draws", draws, 1, MOST)
        check_whole("seed", self.seed, 0, MOST_SEED)
        about = draws, sampling, self.seed, tuple(self.settings)
        found = Campaign(self.rig, names, tuple(self.vary), *about)
        found.check()
        return found

    def _search(self) -> tuple[str, int] | None:
        """Return the search that is asked for and its runs, None for none; RigError."""
        asked = [(kind, runs) for kind in SEARCHES if (runs := getattr(self, kind)) is not None]
        if len(asked) > 1:
            raise RigError(f"{' and '.join(f'--{kind}' for kind, _ in asked)}: give one of them")
        for kind, _ in asked:
            for other in ("draws", "sampling", "until", "shard"):
                if getattr(self, other) is not None:
                    what = f"--{kind} chooses all its own draws; leave it"
                    raise RigError(f"--{other}: {what}")
        return asked[0] if asked else None

    def work(self, campaign: Campaign, folder: Path) -> Work:
        """Return the work on the campaign in a folder; RigError."""
        search = None
        if campaign.sampling in SEARCHES:
            search = Search(campaign, self.of, self.limit)
        elif self.of is not None or self.limit is not None:
            raise RigError("--of and --limit need --worst or --rare")
        shard = Shard() if self.shard is None else Shard.parse(self.shard)
        about = self.until, self.threads, self.scheduler, search
        return Work(campaign, shard, folder, *about)
