"""Which of QEMU's accelerators: KVM only where proven, since it may hang in nested virtualisation.

The proof is a boot: with KVM untried the guest is started on it, and unless it is up in time it is
started again on TCG (the command has not begun by then). The outcome holds until the host reboots.
"""

import os
from pathlib import Path

KVM_BOOT_LIMIT_S = 20.0  # where KVM works, the guest is up in about 2 s
_KVM = Path("/dev/kvm")


def kvm_is_open() -> bool:
    """Say whether /dev/kvm exists and may be used by this user."""
    return os.access(_KVM, os.R_OK | os.W_OK)


def proven_accelerator(cache: Path) -> str | None:
    """Return kvm or tcg as remembered since the host was booted, None if KVM is untried."""
    try:
        boot, outcome = (cache / "accelerator").read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return None
    return outcome if boot == _boot_id() else None


def remember(cache: Path, outcome: str) -> None:
    """Keep the outcome of a boot with KVM: kvm if the guest came up, else tcg."""
    new = cache / f"accelerator.{os.getpid()}"
    new.write_text(f"{_boot_id()} {outcome}\n", encoding="ascii")
    new.replace(cache / "accelerator")


def choice(wanted: str, cache: Path) -> str:
    """Return kvm or tcg to start with; `wanted` is auto, kvm or tcg."""
    if wanted != "auto":
        return wanted
    return "kvm" if kvm_is_open() and proven_accelerator(cache) != "tcg" else "tcg"


def reason(wanted: str, cache: Path) -> str:
    """Return the choice and its reason, for people."""
    kind = choice(wanted, cache)
    if wanted != "auto":
        return f"{kind} (asked for)"
    if not kvm_is_open():
        return f"{kind} (/dev/kvm is missing or not writable)"
    reasons = {"kvm": "KVM has booted", "tcg": "KVM failed to boot", None: "KVM untried; else tcg"}
    return f"{kind} ({reasons[proven_accelerator(cache)]})"


def _boot_id() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
