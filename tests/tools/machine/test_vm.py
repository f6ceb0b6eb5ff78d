"""`pcpc vm` without a boot: quoting, initramfs, kernel tree, end of streams, errors."""

import os
import shlex
import socket
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcpc.tools.cli import main, parsed_options
from pcpc.tools.machine import vm
from pcpc.tools.machine.vm import accelerator, initramfs, kernel, programs, unpack
from pcpc.tools.machine.vm.job import Job, quote, script
from pcpc.tools.machine.vm.machine import PORTS, Size, qemu_command
from pcpc.tools.machine.vm.session import Stream

WORD = st.binary(max_size=30).map(lambda data: data.replace(b"\0", b"~"))
NASTY = [b"a b", b"'q\"", b"$HOME `id` \\n", b"new\nline", b"", bytes(range(1, 256)), b"--", b"*"]


def job(command: list[bytes], environment: dict[bytes, bytes]) -> Job:
    return Job(command, environment, b"/", 0o022, 1000, 1001, [4, 24])


def words_of(line: bytes) -> list[bytes]:
    """Split by the shell's rules without a shell: broken quoting must not run what it lets out."""
    return [word.encode("latin-1") for word in shlex.split(line.decode("latin-1"))]


@given(st.lists(WORD, min_size=1, max_size=4))
def test_quoted_words_are_read_back_unchanged(words: list[bytes]) -> None:
    read = words_of(b" ".join(quote(word) for word in words))
    assert read == words, f"{words} came back as {read}"


def test_a_shell_reads_what_the_rules_say() -> None:
    line = quote(b"it's a \\ $HOME\n\x81\xff*")
    read = subprocess.run(["sh"], input=b"printf %s " + line, stdout=subprocess.PIPE, check=True)
    assert read.stdout == b"it's a \\ $HOME\n\x81\xff*", f"came back as {read.stdout!r}"


def test_command_and_environment_pass_the_job_script_byte_for_byte() -> None:
    environment = {b"ODD%%()": b"() { x; }\n'", b"ALL": bytes(range(1, 256)), b"EMPTY": b""}
    text = script(job([b"prog", *NASTY], environment), "/usr/bin/setpriv")
    read = words_of(text[text.index(b"exec ") :])
    wanted = [b"%s=%s" % pair for pair in environment.items()]
    at = read.index(b"-i") + 1
    assert read[at : at + 3] == wanted, f"environment came back as {read[at : at + 3]}"
    tail = read[read.index(b"--", at) + 1 :]
    assert tail == [b"prog", *NASTY], f"command came back as {tail}"


def test_the_job_runs_as_the_caller_in_its_folder() -> None:
    text = script(job([b"true"], {}), "/usr/bin/setpriv")
    for part in (b"'--reuid=1000' '--regid=1001' '--groups=4,24'", b"umask 0022", b"cd '/'"):
        assert part in text, f"{part!r} is not in {text!r}"


def files_of_initramfs() -> dict[str, bytes]:
    return {"init": b"#!/bin/sh\n", "modules/order": b"vcan.ko\n", "modules/vcan.ko": b"\x7fELF123"}


def test_recipe_hash_changes_with_each_byte_and_name_and_nothing_else() -> None:
    files = files_of_initramfs()
    same = initramfs.recipe_hash(dict(reversed(files.items())))
    assert same == initramfs.recipe_hash(files), f"order of files changes the hash to {same}"
    others = [
        {**files, "init": b"#!/bin/sh \n"},
        {**files, "extra": b""},
        {("vcan" if name == "init" else name): data for name, data in files.items()},
    ]
    hashes = {initramfs.recipe_hash(recipe) for recipe in [files, *others]}
    assert len(hashes) == 4, f"4 recipes have {len(hashes)} hashes"


def read_cpio(archive: bytes) -> dict[str, tuple[int, bytes]]:
    """Read a newc archive by its definition (cpio(5)): name to (mode, data)."""
    entries: dict[str, tuple[int, bytes]] = {}
    at = 0
    while True:
        assert archive[at : at + 6] == b"070701", f"no header at {at}"
        fields = [int(archive[at + 6 + 8 * i : at + 14 + 8 * i], 16) for i in range(13)]
        name = archive[at + 110 : at + 110 + fields[11] - 1].decode()
        start = at + (110 + fields[11] + 3) // 4 * 4
        if name == "TRAILER!!!":
            return entries
        entries[name] = (fields[1], archive[start : start + fields[6]])
        at = start + (fields[6] + 3) // 4 * 4


def test_initramfs_holds_every_file_executable_and_its_folders() -> None:
    files = files_of_initramfs()
    entries = read_cpio(initramfs.archive(files))
    read = {name: data for name, (mode, data) in entries.items() if mode == 0o100755}
    assert read == files, f"read back {read}"
    folders = {name for name, (mode, _) in entries.items() if mode == 0o40755}
    assert folders == {"bin", "dev", "host", "modules", "proc", "sys"}, f"folders are {folders}"


def kernel_tree(folder: Path) -> Path:
    """Make a lib/modules/<release> where vcan needs can-dev, can; virtio is built in."""
    tree = folder / "6.1.0-1-amd64"
    (tree / "kernel" / "net").mkdir(parents=True)
    (tree / "modules.builtin").write_text("kernel/drivers/virtio/virtio.ko\n")
    needs = {"can": "virtio", "can-dev": "can", "vcan": "can-dev,can"}
    for name, depends in needs.items():
        info = f"\0license=GPL\0depends={depends}\0name={name}\0"
        (tree / "kernel" / "net" / f"{name}.ko").write_bytes(b"\x7fELF" + info.encode())
    return tree


def test_modules_load_after_all_they_need(tmp_path: Path) -> None:
    names = [path.name for path in kernel.load_order(kernel_tree(tmp_path), ("vcan", "can"))]
    assert names == ["can.ko", "can-dev.ko", "vcan.ko"], f"order is {names}"


def test_a_kernel_without_vcan_is_named_as_such(tmp_path: Path) -> None:
    tree = kernel_tree(tmp_path)
    (tree / "kernel" / "net" / "vcan.ko").unlink()
    with pytest.raises(vm.VmError, match=r"6\.1\.0-1-amd64 has no module vcan"):
        kernel.load_order(tree, ("vcan",))


def test_the_newest_kernel_of_the_cache_is_used(tmp_path: Path) -> None:
    for release in ("6.1.0-9-amd64", "6.1.0-56-amd64", "5.15.0-200-generic", "tmp-x"):
        (tmp_path / release).mkdir()
    for release in ("6.1.0-9-amd64", "6.1.0-56-amd64", "5.15.0-200-generic"):
        (tmp_path / release / "kernel").touch()
    assert kernel.cached_release(tmp_path) == "6.1.0-56-amd64"
    assert kernel.cached_release(tmp_path / "none") is None


def test_a_boot_image_that_is_not_a_bzimage_is_kept_as_it_is() -> None:
    image = bytes(1000)
    assert unpack.bootable(image) == image


def test_a_module_that_only_zstd_unpacks_names_the_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(vm.VmError, match="missing zstd"):
        unpack.decompress(b"\x28\xb5\x2f\xfd")


@given(st.binary(max_size=300), st.lists(st.integers(1, 40), max_size=30))
def test_a_stream_ends_at_its_mark_however_it_is_cut(data: bytes, cuts: list[int]) -> None:
    mark = b"abac" * 4
    data = data.replace(mark, b"")
    whole, stream, passed = data + mark + b"late", Stream(mark), b""
    for length in [*cuts, len(whole)]:
        passed += stream.feed(whole[:length])
        whole = whole[length:]
    assert stream.ended and passed == data, f"passed {passed!r} of {data!r}"


def test_a_stream_passes_on_what_cannot_be_the_mark_at_once() -> None:
    stream = Stream(b"MARK")
    assert stream.feed(b"live\nM") == b"live\n"
    assert stream.feed(b"x") == b"Mx"


def test_missing_programs_are_named_with_packages_and_cure(tmp_path: Path) -> None:
    for name in ("apt-get", "apt-cache", "dpkg-deb", "setpriv"):
        (tmp_path / name).symlink_to("/bin/true")
    with pytest.raises(vm.VmError) as caught:
        programs.found_programs(search=str(tmp_path))
    text = str(caught.value)
    for part in (
        "qemu-system-x86_64",
        "packages qemu-system-x86 busybox-static",
        "make vcan-tools",
    ):
        assert part in text, f"{part!r} is not in {text!r}"
    assert "\n" not in text and caught.value.code == 4, f"{caught.value.code}: {text!r}"


def test_a_busybox_that_needs_a_loader_is_not_static(tmp_path: Path) -> None:
    loader = tmp_path / "busybox"
    loader.write_bytes(b"\x7fELF" + bytes(500) + b"/lib64/ld-linux-x86-64.so.2\0")
    assert not programs.is_static(loader)


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["vm", "--help"])
    text = capsys.readouterr().out
    assert code == 0 and "example:\n  pcpc vm -- " in text, f"exit code {code}, {text!r}"


def test_a_folder_that_the_guest_does_not_share_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir("/dev/shm")
    code = main(["vm", "--", "true"])
    text = capsys.readouterr().err
    assert code == 4 and "/dev/shm is not shared" in text, f"exit code {code}, {text!r}"


def test_durations_are_read_in_their_unit() -> None:
    texts = ("500ms", "90s", "1.5min", "2h")
    read = [parsed_options(["vm", "--timeout", text, "--", "true"]).timeout_s for text in texts]
    assert read == [0.5, 90.0, 90.0, 7200.0], f"read {read}"


def test_qemu_gets_every_port_and_no_word_of_the_command() -> None:
    numbers = {name: 10 + i for i, name in enumerate((*PORTS, "console"))}
    machine = kernel.Kernel("6.1", Path("/k"), Path("/i"))
    line = qemu_command("qemu", machine, Size(cpus=3, memory_mb=512), "tcg", numbers)
    for name, number in numbers.items():
        assert f"socket,id={name},fd={number}" in line, f"{name} is not in {line}"
    assert line[line.index("-smp") + 1] == "3" and line[line.index("-m") + 1] == "512", f"{line}"


def test_a_proof_of_kvm_is_forgotten_when_the_host_reboots(tmp_path: Path) -> None:
    assert accelerator.proven_accelerator(tmp_path) is None
    accelerator.remember(tmp_path, "tcg")
    assert accelerator.proven_accelerator(tmp_path) == "tcg"
    assert accelerator.choice("auto", tmp_path) == "tcg"
    assert accelerator.choice("kvm", tmp_path) == "kvm"
    (tmp_path / "accelerator").write_text("another-boot tcg\n")
    assert accelerator.proven_accelerator(tmp_path) is None


def test_a_socket_pair_half_closed_still_gives_what_was_sent() -> None:
    """What Machine.close relies on: the peer reads all, then end of file, no hang-up."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.sendall(b"job")
        ours.shutdown(socket.SHUT_WR)
        assert theirs.recv(10) == b"job" and theirs.recv(10) == b""
        theirs.sendall(b"back")
        assert ours.recv(10) == b"back"


def test_the_guests_scripts_are_valid_shell() -> None:
    folder = Path(vm.__file__).parent
    for name in ("init.sh", "guest.sh"):
        checked = subprocess.run(
            ["sh", "-n", os.fspath(folder / name)], capture_output=True, text=True
        )
        assert checked.returncode == 0, f"{name}: {checked.stderr}"
