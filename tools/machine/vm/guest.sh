# Process 1 of the guest, with the caller's root file system: brings vcan0 up, takes the job (a shell
# script, job.py) from the host, runs it and reports its exit status. Five virtio serial ports:
#   control  guest: `up`, `exit N`; host: `MARK split|merged HOSTNAME`, then names of signals for the job
#   job, in  host to guest until end of file, after the guest has written a byte (then it is connected)
#   out, err guest to host; MARK ends the stream
# The job writes to FIFOs, not to the ports: a port opens only once, so `echo >/dev/stderr` would fail.
b=/run/pcpc-vm/busybox
cd /run/pcpc-vm || exit 1

fail() {
    echo "pcpc-vm: $1" >/dev/console
    $b reboot -f
}

port() {
    while :; do
        for folder in /sys/class/virtio-ports/*; do
            if read -r name 2>/dev/null <"$folder/name" && [ "$name" = "pcpc.$1" ]; then
                [ -c "/dev/${folder##*/}" ] && echo "/dev/${folder##*/}" && return
            fi
        done
        $b usleep 20000
    done
}

$b ip link set lo up
$b ip link add dev vcan0 type vcan || fail "cannot create vcan0"
$b ip link set vcan0 up || fail "cannot bring vcan0 up"
$b ip route add 224.0.0.0/4 dev lo                      # multicast stays inside
echo 100 >/proc/sys/vm/dirty_writeback_centisecs        # a killed guest loses at most
echo 100 >/proc/sys/vm/dirty_expire_centisecs           # about 2 s of written data

exec 3<>"$(port control)"
echo up >&3
read -r mark streams hostname <&3
$b hostname "$hostname"
exec 4<>"$(port job)"
echo >&4
$b cat <&4 >job
exec 4>&-

$b mkfifo -m 666 in out err
exec 5<>out 6<>err
$b cat <out >"$(port out)" &
$b cat <err >"$(port err)" &
{
    exec 4<>"$(port in)"
    echo >&4
    exec $b cat <&4 >in
} &
while read -r signal <&3; do
    $b kill "-$signal" "-$($b cat pid)"
done &

errors=err
[ "$streams" = merged ] && errors=out
( exec $b sh job <in >out 2>$errors 3>&- 5>&- 6>&- )
status=$?
$b sync
echo "exit $status" >&3
printf %s "$mark" >&5
printf %s "$mark" >&6
$b sleep 60        # the host ends QEMU when it has everything
$b reboot -f
