#!/usr/bin/env bash
# The tests on a real vcan0 (marker vcan): here if this kernel has vcan0, else in `pcpc vm`.
#   vcan_stage.sh [pytest arguments]
# First the compile cache is filled on this side, since an emulated processor compiles for half an
# hour; the host's file system is the guest's, so it serves both. Fails unless every test was run.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=$PWD/.venv/bin
out=build/vcan
least=61                 # tests; a stage that collects fewer has lost some
limit=30min              # an idle machine needs 5
rig=plants/atb1000/rigs/slew10.yaml

quietly() {
    "$@" >"$out/quietly.log" 2>&1 && return
    local code=$?
    cat "$out/quietly.log"
    echo "vcan stage: exit code $code on this side, before any vcan0: $*" >&2
    exit 1
}
say() { echo "vcan stage: $1, $((SECONDS / 60)) min $((SECONDS % 60)) s"; }

rm -rf "$out"
mkdir -p "$out"
held="require=[{always: time.t_s >= 0}]"   # for the rig's limits a second is too short
once=(--set duration_s=1.0 --set "$held" --no-figure --quiet)
quietly "$bin/pcpc" simulate "$rig" "${once[@]}" -o "$out/simulated"
quietly "$bin/pcpc" run "$rig" "${once[@]}" -o "$out/warm" --pacing lockstep \
    --bus udp_multicast:239.74.163.3:43119
quietly "$bin/python" -m pytest tests/contract/test_ways.py -q -p no:cacheprovider \
    -k "on_a_bus and not branched"
quietly "$bin/pcpc" play "$out/simulated/log.mcap" -r 0 --quiet --bus udp_multicast:239.74.163.3:43119
quietly "$bin/pcpc" bus emulate udp_multicast:239.74.163.3:43119 udp_multicast:239.74.163.3:43120 \
    --for 50ms
quietly "$bin/python" - <<'PY'
from pcpc.drivers.can import wire, wire_layout
from pcpc.drivers.compiled.jit import numba
import numpy as np

end = np.zeros(1, wire_layout.Wire.dtype).view(np.recarray)[0]
wire.prepare(end, wire_layout.Medium.MEMORY, -1, -1)
wire.put_frame(end), wire.get_frame(end, True)  # as the tests call them, beside the loop
PY
say "compiled, simulated"

export PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 PYTHONUNBUFFERED=1
tests=("$bin/python" -m pytest tests/vcan -m vcan -vv -ra --durations=8 -p no:cacheprovider
    --simulated "$out/simulated" --junitxml="$out/results.xml" --basetemp="$out/runs" "$@")
if [ -e /sys/class/net/vcan0 ] && [ "$(id -u)" = 0 ]; then
    where=here
    "${tests[@]}" && code=0 || code=$?
else
    where="in pcpc vm"
    # 3 GB: each node locks 0.4 GB, and where memory ends the kernel kills one
    # -R: with equal addresses in all processes QEMU translates shared code once, not once in each
    "$bin/pcpc" vm --timeout "$limit" --memory 3072 -- setarch -R "${tests[@]}" && code=0 || code=$?
fi
say "tests $where ended with exit code $code"

"$bin/python" - "$out/results.xml" "$least" <<'PY'
import sys
import xml.etree.ElementTree as xml

path, least = sys.argv[1], int(sys.argv[2])
try:
    suites = list(xml.parse(path).getroot().iter("testsuite"))
except (OSError, xml.ParseError) as error:
    sys.exit(f"vcan stage: no results: {error}")
count = {k: sum(int(s.get(k, 0)) for s in suites) for k in ("tests", "failures", "errors", "skipped")}
print("vcan stage:", ", ".join(f"{number} {name}" for name, number in count.items()))
if count["tests"] < least:
    sys.exit(f"vcan stage: {count['tests']} tests were run, expected {least} or more")
if count["skipped"]:
    sys.exit("vcan stage: nothing may be skipped here")
sys.exit(bool(count["failures"] or count["errors"]))
PY
[ "$code" = 0 ] || exit "$code"
for log in "$out"/runs/*/*/log.mcap "$out"/runs/*/log.mcap; do
    [ -e "$log" ] || continue
    "$bin/pcpc" replay "$log" --quiet || { echo "vcan stage: $log is not recomputed" >&2; exit 1; }
done
say "logs of vcan0 recomputed bit for bit"
PCPC_CI_ON_VCAN=1 "$bin/python" -m pytest tests/docs/test_ci.py -q -p no:cacheprovider
say "the workflow of docs/howto/ci.md carried out, its step on vcan0 too"
