"""No option is accepted in silence: neither one without effect nor one that is given twice."""

import pytest

from pcpc.tools.cli import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("bus hull --queue 3", "--queue: only with emulate"),
        ("bus hull --queue 64", "--queue: only with emulate"),
        ("bus hull --errors p=0", "--errors: only with emulate"),
        ("bus hull --for 2s", "--for: only with emulate"),
        ("bus emulate vcan0 vcan1 --rate 2kHz", "--rate: about a rig; emulate has none"),
        ("bus emulate vcan0 vcan1 --set bus.queue=1", "--set: about a rig; emulate has none"),
        ("bus emulate vcan0 vcan1 --any-phase", "--any-phase: about a rig; emulate has none"),
        ("bus emulate vcan0 vcan1 --errors=", "--errors : : expected p=1e-5,burst=2,seed=7"),
        ("bus emulate a b --errors p=1e-5,p=1e-4", "--errors p=1e-5,p=1e-4: p: given twice"),
        ("check hull --standby=", "pcpc check: --standby '': names no controller"),
        ("fault --end", "--end: of which fault? give its NAME"),
        ("fault --for 1s", "--for: of which fault? give its NAME"),
        ("fault x --end --value 2", "--value: contradicts --end"),
        ("top --once --every 1s", "--every: contradicts --once"),
        ("compare a b --jobs 2", "--jobs: only with --against; two recordings are compared as"),
        ("compare a b --all-controllers", "--all-controllers: only with --against; two"),
        ("get a --at bench:8642", "--at is gone; run it there: ssh -t bench pcpc get a"),
        ("get a --at=[fd00::7]:86", "--at is gone; run it there: ssh -t fd00::7 pcpc get a"),
        (
            "top --at bench --ca x.pem --once --plain --token-file=t",
            "--at is gone; run it there: ssh -t bench pcpc top --once",
        ),
        ("stop --plain --quick", "--at is gone; run it there: ssh -t HOST pcpc stop --quick"),
        ("check hull --standby=--", "pcpc check: --standby '--': expected a value"),
        ("get a --ca=--", "pcpc get: --ca '--': expected a value"),
        ("check hull --set=--", "pcpc check: --set '--': expected a value"),
        ("check hull --controller pd --controller pid", "pcpc check: --controller: given"),
        ("run hull -o a -o b", "pcpc run: -o: given twice, with two values"),
        ("log plot latest -o a.png --output b.png", "pcpc log plot: --output: given twice"),
        ("jitter --rounds 3 --rounds 4", "pcpc jitter: --rounds: given twice, with two"),
    ],
)
def test_it_is_refused(words: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.splitlines()[-1].startswith(said), err


def test_twice_the_same_is_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bus", "hull", "--rate", "500Hz", "--rate", "500", "--json", "--json"]) == 0
    assert '"rate_hz": 500.0' in capsys.readouterr().out
