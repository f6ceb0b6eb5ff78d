"""Keyframes: the loop copies once in a while what `nodes.planned_keyframes` has chosen."""

from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.executive.loop.layout import KEYFRAME_HEAD, Loop


@loop_inline
def keep_frame(n: Loop) -> None:
    """Publish a keyframe when it is time for one."""
    if n.passes == n.keep.next:
        copy_out(n)


@loop_function
def copy_out(n: Loop) -> None:
    """Copy what is kept, under the seqlock."""
    keep, s = n.keep, n.keyframe_seq[0] | 1
    keep.next = n.passes + keep.every
    libc.store_release(n.keyframe_seq, 0, s)
    libc.fence_release()
    n.keyframe[0], n.keyframe[1], n.keyframe[2] = n.passes, n.k, n.clock.wake
    into, out_of = libc.address(n.keyframe) + 8 * KEYFRAME_HEAD, libc.address(n.v)
    for i in range(keep.n):
        libc.memcpy(into, out_of + keep.span[i].start, keep.span[i].length)
        into += keep.span[i].length
    libc.store_release(n.keyframe_seq, 0, s + 1)
