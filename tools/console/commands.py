"""All commands of `pcpc`, in the order of use: name, help, example, arguments, exit codes."""

from pcpc.drivers.errors import Exit
from pcpc.tools.console import arguments as take
from pcpc.tools.console import evidence_arguments as take_evidence
from pcpc.tools.console import fit_arguments as take_fit
from pcpc.tools.console import generate_arguments as take_generate
from pcpc.tools.console import live_arguments as take_live
from pcpc.tools.console import log_arguments as take_log
from pcpc.tools.console import margin_arguments as take_margin
from pcpc.tools.console.command import Command, exit_codes

SUITES = {  # of `pcpc bench`: its modules
    "steps": "one step of controllers and plant against C at -O2",
    "generated": "C that `pcpc generate c` makes of laws against C by hand",
    "wake": "how late the executive wakes, against cyclictest and C",
    "cycle": "one cycle of the executive, in memory and on a bus, against C",
    "frame": "one frame sent and received against C and python-can",
    "codec": "packing and unpacking of all frames of the DBC against cantools and C",
    "recorder": "the recorder's throughput against mcap, its effect on the loop",
    "simulate": "a virtual run against C and scipy",
    "batch": "runs in lanes against C and scipy, two threads against one",
    "rate": "the highest closed-loop rate of two processes against C",
    "host": "lateness with the page of `pcpc host` and its clients against without",
    "startup": "the time from command to first cycle, warm and cold",
}
_VM = """
The command runs as you, in this folder, with this environment, on the host's
files (read and write); /run and /dev/shm are the guest's own. Its stdin,
stdout and stderr are pipes, not a terminal. There is no network but loopback.
The first run fetches about 70 MB with apt, no root needed. Ctrl-C goes to the
command; twice, it ends the machine. Emulated time is not real time: use this
for function, not for timing. Its exit code is the command's; 124 time limit,
127 no such command.
"""
_SIMPLE = {Exit.OK: "", Exit.WRONG_INPUT: ""}
_ASKING = {**_SIMPLE, Exit.ENVIRONMENT: "no such node, or no answer", Exit.INTERRUPTED: ""}
_READING = {**_SIMPLE, Exit.LOSS: "the log is damaged", Exit.INTERRUPTED: ""}
_WRITING = {
    **_SIMPLE, Exit.LOSS: "a log is damaged, what is readable was written",
    Exit.ENVIRONMENT: "cannot be written, or a package is missing", Exit.INTERRUPTED: "",
}  # fmt: skip

_GENERATE = (
    Command("c", "write readable C99 of a law, or of all laws of a rig's executive, wired",
            "pcpc generate c pd_nn_fast -o firmware\n"
            "pcpc generate c hull --controller pd_nn_fast --check",
            take_generate.c, "generate.cli",
            {Exit.OK: "", Exit.NOT_MET: "a build gives other bits", Exit.WRONG_INPUT: "",
             Exit.ENVIRONMENT: "a compiler is missing, or DIR cannot be written"},
            compiles=True),
    Command("fmu", "make an FMU of a rig's plant, FMI 2.0 for co-simulation, with its bits",
            "pcpc generate fmu slew10 -o barrel.fmu", take_generate.fmu, "generate.fmu",
            {**_SIMPLE, Exit.ENVIRONMENT: "no compiler, or FILE cannot be written"},
            compiles=True),
)  # fmt: skip

_LOG = (
    Command("info", "tell what a log holds and what is missing in it", "pcpc log info latest",
            take_log.info, "log.info", _READING),
    Command("cat", "print the messages of a log as text",
            "pcpc log cat latest --topics /can/frames --end 500ms",
            take_log.cat, "log.cat", _READING),
    Command("diff", "compare two logs, variable by variable and frame by frame",
            "pcpc log diff runs/A runs/B 'controller.*' --absolute 1e-9",
            take_log.diff, "log.diff",
            {Exit.OK: "equal", Exit.NOT_MET: "they differ", Exit.WRONG_INPUT: "",
             Exit.LOSS: "equal as far as they are readable", Exit.INTERRUPTED: ""}),
    Command("recover", "write what is readable of a damaged log to a new file",
            "pcpc log recover latest", take_log.recover, "log.recover",
            {Exit.OK: "something was recovered", Exit.WRONG_INPUT: "nothing was",
             Exit.LOSS: "the disk is full", Exit.ENVIRONMENT: "cannot be written",
             Exit.INTERRUPTED: ""}),
    Command("export", "write frames as candump, BLF, ASC, or variables as CSV, Parquet",
            "pcpc log export latest -o frames.blf", take_log.export, "log.export", _WRITING),
    Command("import", "make a log of a recording: candump, BLF, ASC, what else python-can reads",
            "pcpc log import drive.blf --dbc car.dbc -o drive.mcap",
            take_log.import_, "log.importer", _WRITING),
    Command("require", "judge a log by what its rig requires in time, or by other requirements",
            "pcpc log require latest --require 'never: abs(controller.e_rad) > 5 mrad, after: 1s'",
            take_log.require, "log.require",
            {Exit.OK: "held", Exit.NOT_MET: "violated", Exit.WRONG_INPUT: "",
             Exit.LOSS: "held as far as the log is readable", Exit.INTERRUPTED: ""}),
    Command("plot", "draw variables over time, of one log or several",
            "pcpc log plot runs/A runs/B controller.e_rad 'barrel.*' -o e.png",
            take_log.plot, "log.plot", _WRITING),
    Command("animate", "show the plant of a log as it moved, as a GIF",
            "pcpc log animate latest -o barrel.gif\n"
            "pcpc log animate latest --start 0.4s --end 1.6s --speed 0.2 -o slew.gif",
            take_log.animate, "log.animate", _WRITING),
)  # fmt: skip

GROUPS = {
    "a rig, from choosing one to a verdict": (
        Command("rigs", "list the rigs that come with pcpc", "pcpc rigs atb1000 'friction-*'",
                take.rigs, codes=_SIMPLE),
        Command("new", "write a rig of your own to begin with: a DC motor with an encoder",
                "pcpc new my-motor\npcpc new my-motor --device", take.new,
                codes={**_SIMPLE, Exit.ENVIRONMENT: "the folder cannot be written"}),
        Command("dbc", "write a DBC file from the wiring of a rig that has none",
                "pcpc dbc probe -o new.dbc", take.dbc,
                codes={**_SIMPLE, Exit.ENVIRONMENT: "the file cannot be written"}, compiles=True),
        Command("check", "check a rig file and print its wiring and bus load", "pcpc check hull",
                take.check, codes={**_SIMPLE, Exit.ENVIRONMENT: "the bus"}, judges=True,
                compiles=True),
        Command("bus", "tell the load of its bus and when each frame is there in the worst case",
                "pcpc bus hull\npcpc bus hull --rate 2kHz --bitrate 1M --data-bitrate 4M\n"
                "pcpc bus emulate vcan0 vcan1 --bitrate 500k --errors p=1e-5,seed=7",
                take.bus,
                codes={Exit.OK: "it fits", Exit.NOT_MET: "a frame is late", Exit.WRONG_INPUT: "",
                       Exit.LOSS: "emulate: a frame was lost", Exit.ENVIRONMENT: "emulate: a bus",
                       Exit.INTERRUPTED: "emulate"}),
        Command("run", "start emulator, executive and recorder, end with a verdict",
                "pcpc run hull\npcpc run hull --host --write", take.run, judges=True,
                compiles=True),
        Command("simulate", "run the same in virtual time, in one process, without a bus",
                "pcpc simulate hull --controller pid --set barrel.gap_rad=0.003", take.simulate,
                judges=True, compiles=True),
        Command("sweep", "run it a thousand times with values that vary: table, statement, report",
                "pcpc sweep hull --controllers pd,pd_nn --vary barrel.gap_rad=x0.5:2 --draws 200\n"
                "pcpc sweep hull --vary barrel.gap_rad=x0.5:2 --until 'p_fail < 1e-2 at 95%'\n"
                "pcpc sweep merge SHARDS ...\n"
                "pcpc sweep rerun runs/SWEEP 39 pd --on-bus",
                take.sweep, "sweep.start",
                {Exit.OK: "done, whatever the runs came to", Exit.WRONG_INPUT: "",
                 Exit.LOSS: "the disk is full", Exit.ENVIRONMENT: "a package is missing",
                 Exit.INTERRUPTED: "the same command with -o goes on"},
                judges=True, compiles=True),
        Command("margin", "tell how far its loop is from instability: linearised and measured",
                "pcpc margin sin0.5 --controller pd\n"
                "pcpc margin sin0.5 --at 500ms --amplitude 0.2 -o margins",
                take_margin.margin, "margin.cli",
                {**_SIMPLE, Exit.ENVIRONMENT: "a package is missing", Exit.INTERRUPTED: ""},
                compiles=True),
        Command("experiment", "run a whole study in virtual time: tables and figures",
                "pcpc experiment chapter9 -o results", take.experiment,
                codes={Exit.OK: "", Exit.NOT_MET: "a run failed", Exit.WRONG_INPUT: "",
                       Exit.LOSS: "", Exit.ENVIRONMENT: "", Exit.INTERRUPTED: ""},
                judges=True, compiles=True),
    ),
    "its nodes one by one, in several terminals or on several machines": (
        Command("plant", "start the emulator only, or with a device of yours as the executive",
                "pcpc plant hull --bus vcan0\n"
                "pcpc plant probe --pacing lockstep --device ./firmware {bus}",
                take.plant, "device.cli", judges=True, compiles=True, last="--device"),
        Command("generate", "write C from laws and rigs, or an FMU of a plant, with their bits",
                "pcpc generate c pd -o firmware", compiles=True, parts=_GENERATE),
        Command("slcan", "put a device on a bus that speaks slcan on a serial line, or in QEMU",
                "pcpc slcan vcan0 /dev/ttyACM0\n"
                "pcpc slcan vcan0 -- sh firmware/qemu.sh m7",
                take.slcan, "device.slcan",
                {Exit.OK: "the line has ended", Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "the bus"},
                notes="of a program the exit code is its own", rest="PROGRAM ..."),
        Command("exec", "start executive and recorder only", "pcpc exec hull --bus vcan0",
                take.run, "run", judges=True, compiles=True),
        Command("local", "start the node between the two only, of a rig with three",
                "pcpc local telerobot-u1 --bus vcan0", take.run, "run", judges=True,
                compiles=True),
    ),
    "while it runs": (
        Command("list", "list the variables of a node with values, units and ranges",
                "pcpc list 'controller.*'", take_live.list_, "watch", _ASKING),
        Command("get", "print values", "pcpc get controller.e_rad barrel.theta_rad\n"
                "pcpc get controller.e_rad --at localhost:8642 --token-file rig.token",
                take_live.table("NAME", "+"), "watch", _ASKING),
        Command("set", "tune parameters, all at once",
                "pcpc set controller.kv_Nms_rad=120 controller.lam_per_s=15\n"
                "PCPC_TOKEN=... pcpc set controller.kv_Nms_rad=120 --at rig-machine:8642",
                take_live.table("NAME=VALUE", "+"), "watch", _ASKING),
        Command("save", "write the parameters that were tuned to a file", "pcpc save tuned.yaml",
                take_live.save, "tunings", _ASKING,
                notes="a rig takes them over with --set @FILE, a running one with `pcpc load`"),
        Command("load", "tune parameters to what a file says, all at once or none",
                "pcpc load tuned.yaml", take_live.load, "tunings", _ASKING),
        Command("undo", "go back to the values before the last tuning, whoever made it",
                "pcpc undo\npcpc undo 3", take_live.undo, "tunings", _ASKING),
        Command("watch", "print values again and again", "pcpc watch 'controller.*' --every 500ms",
                take_live.watch, codes=_ASKING),
        Command("top", "show a run on one screen: states, faults, timing, frames, parameters",
                "pcpc top\npcpc top hull --once", take_live.top, "top.cli",
                {**_SIMPLE, Exit.ENVIRONMENT: "--once: no such run", Exit.INTERRUPTED: ""},
                notes="q or Ctrl-C ends it; where a run ends, it waits for the next"),
        Command("host", "show a run or a log in any browser: moving plots, tuning, timing",
                "pcpc host --write\npcpc host latest\npcpc host --foxglove", take_live.host,
                "host.cli", {Exit.OK: "Ctrl-C", Exit.WRONG_INPUT: "",
                 Exit.ENVIRONMENT: "a package or the port is missing"}, reads_logs=True),
        Command("scope", "capture every cycle around a trigger into a log",
                "pcpc scope 'controller.*' --trigger 'abs(controller.e_rad) > 2 mrad' "
                "-o burst.mcap --plot burst.png",
                take_live.scope,
                codes={Exit.OK: "", Exit.NOT_MET: "no trigger", Exit.WRONG_INPUT: "",
                       Exit.LOSS: "cycles were lost", Exit.ENVIRONMENT: "no such node",
                       Exit.INTERRUPTED: ""}),
        Command("lock", "forbid tunings (tune, all), or allow them again (none)",
                "pcpc lock tune", take_live.table("none|tune|all", 1), "watch", _ASKING),
        Command("stop", "end a run in order, also one that is locked", "pcpc stop --quick",
                take_live.stop, "stop", _ASKING),
        Command("reset", "go on after a fault that waits (supervisor.on_fault)", "pcpc reset hull",
                take_live.reset, "stop", {**_ASKING, Exit.NOT_MET: "its cause is still there"}),
        Command("arm", "close the loop of a run that waits for it (supervisor.arm)", "pcpc arm",
                take_live.operate, "operate", {**_ASKING, Exit.NOT_MET: "not in this state"}),
        Command("hold", "ramp commands to their safe values, without a fault", "pcpc hold",
                take_live.operate, "operate", _ASKING,
                notes="time, references and laws go on; `pcpc resume` closes the loop again"),
        Command("resume", "go on after `pcpc hold`: commands rise as fast as they fell",
                "pcpc resume", take_live.operate, "operate",
                {**_ASKING, Exit.NOT_MET: "not in this state"}),
        Command("handover", "let another controller take over, without a step",
                "pcpc run hull --controller pd --standby pd_nn\npcpc handover pd_nn",
                take_live.handover, "operate",
                {**_ASKING, Exit.NOT_MET: "it is not usable; who is in charge stays"}),
        Command("fault", "list the faults on purpose of a rig, begin or end one",
                "pcpc fault encoder_stuck --for 200ms", take_live.fault, codes=_ASKING),
        Command("watchdog", "watch a run from its bus alone; send its stop frame if it goes wrong",
                "pcpc watchdog hull --bus vcan0 --feed /dev/watchdog", take_live.watchdog,
                codes={Exit.OK: "Ctrl-C, nothing was wrong", Exit.WRONG_INPUT: "",
                       Exit.ENVIRONMENT: "", Exit.SAFETY_STOP: "the stop frame was sent"},
                notes="RIG needs a supervisor.stop_frame: docs/bus-safety.md", judges=True,
                compiles=True),
    ),
    "afterwards": (
        Command("log", "look into logs, compare, draw, convert and repair them",
                "pcpc log info latest", compiles=True, reads_logs=True, parts=_LOG),
        Command("report", "write a run as one HTML file, to hand on or to print",
                "pcpc report latest\npcpc report runs/A -o a.html", take_log.report, "report",
                _WRITING, reads_logs=True),
        Command("replay", "recompute a recorded run and compare it bit by bit",
                "pcpc replay latest", take.replay,
                codes={Exit.OK: "bit-identical", Exit.NOT_MET: "different or incomplete",
                       Exit.WRONG_INPUT: "", Exit.SAFETY_STOP: "a step hangs or raises",
                       Exit.INTERRUPTED: ""},
                judges=True, compiles=True, reads_logs=True),
        Command("bounds", "hold a run against the theorem of its law: V, V', ultimate bound",
                "pcpc bounds friction-c\npcpc bounds latest --plot bounds.png", take.bounds,
                codes={Exit.OK: "it holds, or no theorem is known", Exit.NOT_MET: "violated",
                       Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "a package is missing",
                       Exit.INTERRUPTED: ""},
                judges=True, compiles=True, reads_logs=True),
        Command("fit", "estimate parameters of the plant from a log, with 95 % intervals",
                "pcpc fit slew10 latest\n"
                "pcpc fit slew10 latest --parameter barrel.gap_rad=0:0.01 -o fitted\n"
                "pcpc simulate slew10 --set @fitted/fit.yaml",
                take_fit.fit, "fit.cli",
                {Exit.OK: "", Exit.NOT_MET: "the log tells nothing of a --parameter",
                 Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "a package is missing",
                 Exit.INTERRUPTED: ""},
                judges=True, compiles=True, reads_logs=True),
        Command("compare", "tell what two runs, or two versions of the rigs, differ in",
                "pcpc compare runs/A runs/B\n"
                "pcpc compare --against origin/main --markdown table.md -o compared",
                take.compare, "compare.cli",
                {Exit.OK: "equal", Exit.NOT_MET: "they differ", Exit.WRONG_INPUT: "",
                 Exit.LOSS: "a disk is full", Exit.ENVIRONMENT: "git, a package is missing",
                 Exit.INTERRUPTED: ""},
                judges=True),
        Command("play", "put recorded frames on a bus, at their times",
                "pcpc play latest --bus vcan0\n"
                "pcpc play latest --start 2 --duration 1 --loop --only FB_A --only 0x080\n"
                "pcpc play latest --as plant --bus vcan0    # beside: pcpc exec RIG --bus vcan0",
                take.play,
                codes={Exit.OK: "played", Exit.WRONG_INPUT: "",
                       Exit.LOSS: "send errors or damaged log", Exit.ENVIRONMENT: "",
                       Exit.INTERRUPTED: ""},
                judges=True, compiles=True, reads_logs=True),
    ),
    "this machine": (
        Command("completion", "let a shell complete commands, rigs, controllers and variables",
                "pcpc completion bash", take.completion, module="console.completion", codes=_SIMPLE,
                notes='~/.bashrc, ~/.zshrc: eval "$(pcpc completion bash)", or zsh\n'
                "~/.config/fish/config.fish: pcpc completion fish | source"),
        Command("doctor", "what it offers, and how to get the rest", "pcpc doctor", take.doctor,
                codes={Exit.OK: "a rig can run", Exit.ENVIRONMENT: "it cannot"}),
        Command("jitter", "measure the timing of the loop, beside cyclictest and C",
                "pcpc jitter -i 1000us -D 60s -p 80 -h 400 --json=jitter.json\n"
                "pcpc jitter -D 25s --against cyclictest,c,python --plot jitter.png",
                take.jitter,
                codes={Exit.OK: "measured", Exit.WRONG_INPUT: "",
                       Exit.LOSS: "the log is not whole", Exit.ENVIRONMENT: "",
                       Exit.INTERRUPTED: ""},
                judges=True, own_h=True),
        Command("bench", "measure ratios against C and others, interleaved in one run",
                "pcpc bench steps --json steps.json", take.bench,
                codes={**_SIMPLE, Exit.ENVIRONMENT: "a yardstick is missing", Exit.INTERRUPTED: ""},
                notes="suites:\n" + "\n".join(f"  {name:9}{text}" for name, text in SUITES.items()),
                compiles=True),
        Command("evidence", "inject every fault, count what notices it, write a page of all",
                "pcpc evidence\npcpc evidence mutants kills --kills 32",
                take_evidence.evidence, "evidence.start",
                {Exit.OK: "all as stated", Exit.NOT_MET: "something was not", Exit.WRONG_INPUT: "",
                 Exit.ENVIRONMENT: "the folder cannot be written", Exit.INTERRUPTED: ""},
                compiles=True),
        Command("soak", "run after run with other tunings and faults for hours; check each log",
                "pcpc soak hull --hours 8", take_evidence.soak, "evidence.soak",
                {Exit.OK: "nothing wrong", Exit.NOT_MET: "a log was", Exit.WRONG_INPUT: "",
                 Exit.INTERRUPTED: ""}, compiles=True),
        Command("vm", "run a command on a kernel with vcan, in QEMU",
                "pcpc vm -- sh -c 'candump -n 1 vcan0 & sleep 1; cansend vcan0 123#C0; wait'",
                take.vm, "vm.cli",
                {Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "no machine, or it broke"},
                notes=_VM, judges=True, rest="COMMAND [ARGUMENT ...]"),
    ),
}  # fmt: skip
COMMANDS = {command.name: command for group in GROUPS.values() for command in group}


def overview() -> str:
    """Return the help's list of commands."""
    lines = []
    for title, group in GROUPS.items():
        lines += [f"{title}:", *(f"  {one.name:12}{one.help}" for one in group), ""]
    return "\n".join([
        *lines, "`pcpc COMMAND --help` tells the options of each, with an example.",
        "RIG is a name (pcpc rigs) or a file; LOG a file, a run folder, or `latest`.",
        exit_codes(),
    ])  # fmt: skip
