#!/bin/busybox sh
# First program of the guest, in its initramfs: loads the modules, mounts the caller's root file
# system (9p tag `host`) and goes over to guest.sh there. On failure the machine resets, which ends QEMU.
b=/bin/busybox

fail() {
    echo "pcpc-vm: $1" >/dev/console
    $b reboot -f
}

$b mount -t devtmpfs dev /dev
$b mount -t proc proc /proc
$b mount -t sysfs sys /sys
for module in $($b cat /modules/order); do
    $b insmod "/modules/$module" || fail "cannot load $module"
done

options=trans=virtio,version=9p2000.L,msize=1048576,cache=loose
$b mount -t 9p -o $options host /host || fail "cannot mount the host's file system"
for folder in proc sys dev; do
    $b mount -o move /$folder /host/$folder || fail "cannot move /$folder"
done
# /run and /dev/shm are the guest's own: sockets and shared memory of the host mean nothing here
$b mount -t tmpfs -o mode=755 tmpfs /host/run || fail "cannot mount /run"
$b mkdir -p /host/dev/shm /host/dev/pts /host/run/lock /host/run/pcpc-vm
$b mount -t tmpfs -o mode=1777 tmpfs /host/dev/shm
$b mount -t devpts -o mode=620,ptmxmode=666 devpts /host/dev/pts
$b ln -sf /proc/self/fd /host/dev/fd
for n in 0:stdin 1:stdout 2:stderr; do
    $b ln -sf "/proc/self/fd/${n%:*}" "/host/dev/${n#*:}"
done
$b chmod 1777 /host/run/lock

$b cp /bin/busybox /guest.sh /host/run/pcpc-vm || fail "cannot copy the guest's program"
exec $b switch_root /host /run/pcpc-vm/busybox sh /run/pcpc-vm/guest.sh
