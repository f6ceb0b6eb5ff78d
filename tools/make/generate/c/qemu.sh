#!/bin/sh
# sh qemu.sh m7 | m4: the image in QEMU, its slcan line on stdin and stdout; as a device:
#   pcpc run RIG --pacing lockstep --device pcpc slcan {bus} -- sh qemu.sh m7
# mux=on lets QEMU take characters ahead: without it each one changes threads, and it is 3 times slower.
case $1 in m7) board=mps2-an500 ;; m4) board=mps2-an386 ;; *) echo "usage: qemu.sh m7|m4" >&2; exit 2 ;; esac
exec qemu-system-arm -M $board -kernel "$(dirname "$0")/$1.elf" -display none -monitor none -semihosting \
    -chardev stdio,id=line,mux=on,signal=off -serial chardev:line
