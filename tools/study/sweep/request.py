"""From what is asked of a campaign, by `pcpc sweep` or `pcpc.sweep`, to it and to its work."""

from pathlib import Path

from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.study.sweep.campaign import SEARCHES, Campaign, Shard
from pcpc.tools.study.sweep.commands import SweepRequest
from pcpc.tools.study.sweep.numbers import MOST, check_whole
from pcpc.tools.study.sweep.search import Search
from pcpc.tools.study.sweep.vary import grid_size, parse_variations
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.arguments import MOST_SEED

DRAWS = 1000


def campaign_of(request: SweepRequest) -> Campaign:
    """Return what is asked, completed; RigError for what contradicts itself, or no run can have."""
    given = request.controllers
    names = () if given is None else tuple(given.split(","))
    sampling, draws = _search(request) or (request.sampling, request.draws)
    if "" in names:
        what = "expected names with a comma between, as pid,pd"
        raise RigError(f"--controllers {given!r}: {what}")
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise RigError(f"--controllers {given}: {twice[0]} is there twice")
    names = names or (load_rig(request.rig, None, request.set).config.controller,)
    until = request.until is not None
    sampling = sampling or ("random" if until or not request.vary else "sobol")
    if until and sampling != "random":
        what = f"--until counts independent draws, and --sampling {sampling} makes others"
        raise RigError(f"{what}; leave --sampling out")
    if draws is None and sampling == "grid":
        draws = grid_size(parse_variations(request.vary))
    if draws is None:
        draws = MOST if until else DRAWS
    check_whole(sampling if sampling in SEARCHES else "draws", draws, 1, MOST)
    check_whole("seed", request.seed, 0, MOST_SEED)
    about = draws, sampling, request.seed, tuple(request.set)
    found = Campaign(request.rig, names, tuple(request.vary), *about)
    found.check()
    return found


def _search(request: SweepRequest) -> tuple[str, int] | None:
    """Return the search that is asked for and its runs, None for none; RigError."""
    asked = [(kind, runs) for kind in SEARCHES if (runs := getattr(request, kind)) is not None]
    if len(asked) > 1:
        raise RigError(f"{' and '.join(f'--{kind}' for kind, _ in asked)}: give one of them")
    for kind, _ in asked:
        for other in ("draws", "sampling", "until", "shard"):
            if getattr(request, other) is not None:
                what = f"--{kind} chooses all its own draws; leave it"
                raise RigError(f"--{other}: {what}")
    return asked[0] if asked else None


def work_of(request: SweepRequest, campaign: Campaign, folder: Path) -> Work:
    """Return the work on the campaign in a folder; RigError."""
    search = None
    if campaign.sampling in SEARCHES:
        search = Search(campaign, request.of, request.limit)
    elif request.of is not None or request.limit is not None:
        raise RigError("--of and --limit need --worst or --rare")
    shard = Shard() if request.shard is None else Shard.parse(request.shard)
    about = request.until, request.threads, request.scheduler, search
    return Work(campaign, shard, folder, *about)
