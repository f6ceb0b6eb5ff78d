/* The loop in plain C: the yardstick of `tools.dev.bench`. The functions of executive/loop/cycle.py and
 * rings.py on the same LOOP record, with the wire, codec and protection of frame.c and generated steps;
 * the same bits, so that the records of a run are equal.
 *
 * By hand, with frame.c, because nothing generates it: `pcpc generate c` translates steps, without the
 * loop around them, and the loop of the device that it writes (make/generate/c/device.c) has no rings,
 * snapshot, tunings or clocks, so that it is no yardstick for this one.
 */
#include "frame.c"

#include <sched.h>
#include <sys/resource.h>
#include <time.h>

typedef void step_function(double, double, double *, double *, double *, double *);
typedef struct loop loop;

static int stopping(loop *n)
{
    return __atomic_load_n(&n->control.stop, __ATOMIC_ACQUIRE) != 0;
}

/* ------------------------------------------------------------------ executive/loop/clock.py -------- */

static int runs(loop *n)
{
    return n->clock.kind == TIME_REAL || n->clock.kind == TIME_LOCKSTEP;
}

static int64_t now(loop *n)
{
    struct timespec t;
    if (!runs(n))
        return n->clock.now_ns;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static int64_t stamp(loop *n)
{
    return n->clock.kind == TIME_LOCKSTEP ? n->clock.now_ns : now(n);
}

static int paced(loop *n)
{
    return n->clock.trigger == TRIGGER_CLOCKED && n->passes > n->clock.arm_pass;
}

static void set_time(loop *n)
{
    if (n->clock.kind == TIME_LOCKSTEP || n->clock.kind == TIME_VIRTUAL)
        n->clock.now_ns = n->k * n->clock.period_ns;
}

/* ------------------------------------------------------------------ executive/loop/rings.py -------- */

static int64_t bits_of(double value)
{
    int64_t bits;
    if (value != value)
        return 0x7FF8000000000000LL;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static int64_t free_row(loop *n, int64_t put, int64_t *dropped, int64_t *taken, int64_t rows)
{
    while (put - __atomic_load_n(&taken[0], __ATOMIC_ACQUIRE) >= rows) {
        if (!n->rings.wait_recorder || stopping(n)) {
            ++*dropped;
            return -1;
        }
        sched_yield();
    }
    return put % rows;
}

static void was_put(int64_t *head)
{
    __atomic_store_n(head, *head + 1, __ATOMIC_RELEASE);
}

static void push_frame(loop *n, const uint8_t *frame, int64_t received, int64_t state)
{
    int64_t at = free_row(n, n->frame_ends.head, &n->frame_ends.dropped, n->frame_taken, n->rings.frame_rows);
    if (at < 0)
        return;
    uint32_t word;
    int64_t *row = &n->frame[at * n->rings.frame_words];
    memcpy(&word, frame, sizeof word);
    row[OFFRAME_HEADER] = SH_CDR_HEADER;
    row[OFFRAME_STAMP_NS] = stamp(n);
    row[OFFRAME_CYCLE] = n->k;
    row[OFFRAME_ABOUT] = word | (int64_t)frame[4] << 32 | received << 40 | state << 48;
    memcpy(&row[OFFRAME_PAYLOAD], frame + 8, 8);
    was_put(&n->frame_ends.head);
}

static void push_event(loop *n, int64_t code, int64_t argument, double value)
{
    int64_t at = free_row(n, n->event_ends.head, &n->event_ends.dropped, n->event_taken, SH_EVENT_RING_ROWS);
    if (at < 0)
        return;
    n->event[at] = (struct event){stamp(n), n->k, code, argument, bits_of(value)};
    was_put(&n->event_ends.head);
}

static void push_record(loop *n)
{
    int64_t columns = SH_RECORD_HEAD + n->rings.n_state + 1 + n->rings.n_timing;
    int64_t at = free_row(n, n->record_ends.head, &n->record_ends.dropped, n->record_taken, n->rings.record_rows);
    if (at < 0)
        return;
    int64_t *row = n->record + at * columns;
    row[OFRECORD_CYCLE] = n->k;
    row[OFRECORD_STAMP_NS] = n->clock.wake;
    row[OFRECORD_HEADER] = SH_CDR_HEADER;
    row += SH_RECORD_HEAD;
    for (int64_t i = 0; i < n->rings.n_state; i++)
        row[i] = bits_of(n->v[n->rings.state_columns[i]]);
    row += n->rings.n_state;
    row[0] = SH_CDR_HEADER;
    for (int64_t i = 0; i < n->rings.n_timing; i++)
        row[1 + i] = bits_of(n->v[n->rings.timing_columns[i]]);
    was_put(&n->record_ends.head);
}

static void publish(loop *n)
{
    int64_t s = n->seq[0] | 1;
    __atomic_store_n(&n->seq[0], s, __ATOMIC_RELEASE);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    memcpy(n->snapshot, n->v, n->n_variables * sizeof *n->v);
    __atomic_store_n(&n->seq[0], s + 1, __ATOMIC_RELEASE);
}

/* ------------------------------------------------------------------ executive/loop/cycle.py -------- */

static void wait(loop *n)
{
    struct timespec until = {n->clock.deadline / 1000000000, n->clock.deadline % 1000000000};
    if (!runs(n))
        n->clock.now_ns = n->clock.now_ns > n->clock.deadline ? n->clock.now_ns : n->clock.deadline;
    else
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR
               && !stopping(n))
            ;
    n->clock.wake = now(n);
    int64_t late = n->clock.wake - n->clock.deadline;
    n->control.late += late > n->clock.late_ns;
    if (late > n->control.wake_max_ns)
        n->control.wake_max_ns = late;
}

static void arm(loop *n)
{
    int64_t soonest = now(n) + n->clock.period_ns / 8 - n->clock.phase_ns;
    n->clock.deadline = (soonest / n->clock.period_ns + 1) * n->clock.period_ns + n->clock.phase_ns;
}

static void next_cycle(loop *n)
{
    n->passes++;
    n->k++;
    n->clock.deadline += n->clock.period_ns;
    n->clock.behind = 0;
    if (paced(n) && n->timing.done > n->clock.deadline) {
        n->clock.behind = (n->timing.done - n->clock.deadline) / n->clock.period_ns + 1;
        n->k += n->clock.behind;
        n->clock.deadline += n->clock.behind * n->clock.period_ns;
        n->control.skipped += n->clock.behind;
        push_event(n, EVENT_SKIP, n->clock.behind, 0.0);
    }
}

/* ------------------------------------------------ executive/loop/strangers.py, reception.py -------- */

static int64_t frame_of(uint32_t word, frame_row *table, int64_t rows)
{
    for (int64_t row = 0; row < rows; row++)
        if (table[row].can_id == (word & 0x1FFFFFFF) && table[row].extended == word >> 31)
            return row;
    return -1;
}

static int is_foreign(loop *n, int64_t row, uint32_t word)
{
    int64_t source = n->wire.source;
    if (row < 0)
        return frame_of(word, n->tx.frames, n->tx.n) >= 0;
    if (source == n->rx.source[row])
        return 0;
    int64_t silent = STRANGERS_SILENT_TURNS * n->rx.frames[row].every_n;
    if (source == WIRE_STRANGER || (n->rx.source[row] != 0 && n->passes != 0
                                    && n->rx.state[row].age_cycles <= silent))
        return 1;
    n->rx.source[row] = source;
    return 0;
}

static int64_t note(loop *n, int64_t *since, int64_t *count, int64_t cycles)
{
    if (*count == 0 || n->passes - *since >= cycles) {
        *since = n->passes;
        *count = 0;
    }
    return ++*count;
}

static void blame(loop *n, int64_t fault, uint32_t word)
{
    if (n->guard.faulted == FAULT_NONE) {
        n->guard.faulted = fault;
        n->control.culprit = word;
    }
}

static void note_foreign(loop *n, uint32_t word)
{
    n->control.foreign++;
    push_frame(n, n->wire.rx, 1, FRAMESTATE_FOREIGN);
    int64_t found = note(n, &n->rx.foreign.since, &n->rx.foreign.count, STRANGERS_FOREIGN_CYCLES);
    if (found == 1)
        push_event(n, EVENT_FOREIGN, word & 0x1FFFFFFF, n->control.foreign);
    if (found >= STRANGERS_FOREIGN_FRAMES || n->passes == 0)
        blame(n, FAULT_ANOTHER_SENDER, word);
}

/* ---------------------------------------------------------------- executive/loop/meeting.py -------- */

static int64_t sorted_out(loop *n, int64_t row)
{
    int64_t part = n->rx.role[row].meeting, peer = n->rx.role[row].peer - 1;
    peer = peer > 0 ? peer : 0;
    if (part == PART_FROM_ABOVE || part == PART_FROM_BELOW) {
        if (!n->meeting.met[row] || (part == PART_FROM_BELOW && n->meeting.sampled[peer])) {
            n->meeting.met[row] = 1;
            return TURN_TAKE;
        }
        if (part == PART_FROM_BELOW) {
            n->meeting.holding[peer] = row + 1;
            memcpy(n->meeting.held[peer], n->wire.rx, WIRE_CLASSIC_BYTES);
        }
        return TURN_LEAVE;
    }
    if (part == PART_BEFORE)
        n->meeting.holding[peer] = 0;
    if (part == PART_BEFORE || part == PART_AFTER)
        n->meeting.sampled[peer] = 1;
    return part == PART_AFTER && n->meeting.holding[peer] ? TURN_HELD_FIRST : TURN_TAKE;
}

static void exchange_held(loop *n, int64_t peer)
{
    uint8_t frame[WIRE_CLASSIC_BYTES];
    memcpy(frame, n->meeting.held[peer], sizeof frame);
    memcpy(n->meeting.held[peer], n->wire.rx, sizeof frame);
    memcpy(n->wire.rx, frame, sizeof frame);
}

/* -------------------------------------------------------------- executive/loop/reception.py -------- */

static int64_t use_frame(loop *n, int64_t row);

static int64_t take_frame(loop *n)
{
    uint32_t word;
    memcpy(&word, n->wire.rx, sizeof word);
    int64_t row = frame_of(word, n->rx.frames, n->rx.n);
    if (is_foreign(n, row, word)) {
        note_foreign(n, word);
        return -1;
    }
    if (row < 0)
        return -1;
    if (n->meeting.ordered && n->passes == 0) {
        int64_t what = sorted_out(n, row);
        if (what == TURN_LEAVE)
            return -1;
        if (what == TURN_HELD_FIRST) {
            int64_t peer = n->rx.role[row].peer > 1 ? n->rx.role[row].peer - 1 : 0;
            int64_t first = n->meeting.holding[peer] - 1;
            exchange_held(n, peer);
            n->meeting.holding[peer] = 0;
            use_frame(n, first);
            exchange_held(n, peer);
        }
    }
    return use_frame(n, row);
}

static void watch_beat(loop *n, int64_t row)
{
    int64_t every = n->intrusion.beat_every[row], before = n->intrusion.beat_at[row];
    n->intrusion.beat_at[row] = n->k;
    if (before > 0 && n->clock.behind == 0 && 4 * (n->k - before) < 3 * every)
        n->intrusion.early_at[row] = n->k; /* what follows of more of them, nobody tries here */
}

static int64_t use_frame(loop *n, int64_t row)
{
    const uint8_t *frame = n->wire.rx;
    uint32_t word;
    int64_t lost;
    memcpy(&word, frame, sizeof word);
    receiver_row *receiver = &n->rx.state[row];
    int64_t fresh = receiver->fresh;
    int64_t state = check(frame + 8, frame[4], &n->rx.frames[row], receiver, &lost);
    push_frame(n, frame, 1, state);
    n->control.lost += lost;
    if (state == FRAMESTATE_OK || state == FRAMESTATE_OK_SOME_LOST) {
        unpack(frame + 8, &n->rx.frames[row], n->rx.signals, n->v);
        memcpy(n->intrusion.counted_frame[row], frame, WIRE_CLASSIC_BYTES);
        if (n->intrusion.care[row] && n->intrusion.beat_every[row] > 0)
            watch_beat(n, row);
        n->control.received++;
        if (!fresh) {
            n->rx.started += n->rx.role[row].starts;
            n->rx.fresh += n->rx.role[row].awaited;
        }
    } else if (state == FRAMESTATE_ERROR) {
        n->control.crc_errors++;
    } else if (state == FRAMESTATE_REPEATED) {
        n->control.repeated++;
        if (n->rx.role[row].starts + n->rx.role[row].awaited > 0
            && note(n, &n->rx.repeats.since, &n->rx.repeats.count, STRANGERS_REPEATED_CYCLES)
                >= STRANGERS_REPEATED_FRAMES)
            blame(n, FAULT_REPEATED_INPUT, word);
    } else if (state == FRAMESTATE_WRONG_SEQUENCE) {
        n->control.wrong_sequence++;
        n->rx.started += n->rx.role[row].starts;
    }
    return row;
}

static void announce(loop *n);

static void receive(loop *n)
{
    int gather = !paced(n);
    int64_t waits = 0;
    for (int drained = 0; drained < RECEPTION_DRAIN_FRAMES;) {
        if (gather && n->rx.started >= n->rx.starters)
            break;
        int result = get_frame(&n->wire, gather);
        drained += !gather || stopping(n);
        if (result == ARRIVAL_FRAME) {
            take_frame(n);
            waits = 0;
        } else if (result == ARRIVAL_NOTHING) {
            if (!gather || stopping(n))
                break;
            waits++;
            if (n->passes == 0 && runs(n)) {
                announce(n);
                waits = 0;
            } else if (waits >= n->rx.patience || !runs(n)) {
                n->guard.faulted = FAULT_PEER_SILENT;
                break;
            }
        } else if (result == ARRIVAL_FAILED) {
            n->control.bus_errno = n->wire.errno_;
            n->guard.faulted = FAULT_BUS_FAILED;
            break;
        } else if (result == ARRIVAL_BUS_ERROR) {
            n->control.bus_errors++;
        }
    }
    if (n->guard.off && n->guard.faulted == FAULT_NONE)
        n->guard.faulted = FAULT_BUS_OFF;
    n->timing.received = now(n);
}

static int64_t advance(int64_t state, int fresh, int64_t fault, int asked, int ramped, int disarmed)
{
    int64_t event = fresh ? CONDITION_FRESH : CONDITION_MISSED;
    if (asked)
        event = CONDITION_STOP_REQUEST;
    else if (state == STATE_FAULT)
        event = ramped ? CONDITION_RAMPED : CONDITION_NONE;
    else if (fault != FAULT_NONE)
        event = CONDITION_LOSS;
    else if (disarmed && state != STATE_INIT)
        event = CONDITION_DISARMED;
    return NEXT[state][event];
}

static void watchdog(loop *n, int64_t state)
{
    for (int64_t i = 0; i < n->guard.n_safe; i++) {
        double *value = &n->v[n->guard.safe_index[i]];
        struct safe *safe = &n->guard.safe[i];
        if (state < STATE_FAULT)
            safe->last = *value;
        else
            *value = safe->safe + n->guard.gain * (safe->last - safe->safe);
    }
}

static int over(loop *n)
{
    return n->k >= n->guard.cycles || stopping(n)
           || (n->guard.mode_index >= 0 && n->v[n->guard.mode_index] == STATE_STOP);
}

static int settled(loop *n)
{
    for (int64_t i = 0; i < n->limits.n; i++) {
        const struct table *limits = &n->limits.table[i];
        if (__builtin_fabs(limits->sent - limits->safe) > limits->rate)
            return 0;
    }
    return 1;
}

static void begin_ramp(loop *n, int asked)
{
    n->guard.pace = n->guard.ramp_step;
    for (int64_t i = 0; i < n->limits.n; i++) {
        const struct table *limits = &n->limits.table[i];
        double way = __builtin_fabs(limits->last - limits->safe);
        if (way * n->guard.pace > limits->rate)
            n->guard.pace = limits->rate / way;
    }
    if (!asked)
        return;
    n->rx.starters = n->rx.awaited = 0;
    for (int64_t row = 0; row < n->rx.n; row++) {
        const struct role *role = &n->rx.role[row];
        n->rx.starters += role->starts * role->peer;
        n->rx.awaited += role->awaited * role->peer;
    }
}

static int64_t drive_state(loop *n, int64_t state)
{
    if (state == STATE_STOP)
        return POWER_SWITCH_ON_DISABLED;
    if (state == STATE_FAULT)
        return n->guard.gain <= 0.0 && settled(n) ? POWER_FAULT : POWER_FAULT_REACTION_ACTIVE;
    if (state == STATE_INIT)
        return n->control.fault == 0 ? POWER_NOT_READY : POWER_SWITCH_ON_DISABLED;
    if (n->guard.pace > 0.0)
        return POWER_QUICK_STOP_ACTIVE;
    if (state == STATE_READY)
        return POWER_READY_TO_SWITCH_ON;
    return n->guard.gain >= 1.0 ? POWER_OPERATION_ENABLED : POWER_SWITCHED_ON;
}

static void tell_drive(loop *n, int64_t state)
{
    int64_t word = POWER_WORDS[drive_state(n, state)];
    word |= state == STATE_HOLD ? CANOPEN_WARNING : 0;
    word |= n->v[V_CLAMPED] != 0.0 ? CANOPEN_LIMITED : 0;
    n->v[V_STATUS_WORD] = word;
    n->v[V_ERROR_CODE] = ERROR_CODES[n->guard.faulted];
    n->v[V_ERROR_REGISTER] = ERROR_REGISTERS[n->guard.faulted];
}

static void supervise(loop *n)
{
    int64_t before = (int64_t)n->v[V_STATE];
    int asked = over(n);
    int running = before == STATE_RUN || before == STATE_HOLD;
    if (n->rx.fresh >= n->rx.awaited) {
        n->guard.missing = 0;
    } else {
        n->guard.missing++;
        n->control.held += running;
        n->control.stale += running && n->guard.missing > n->guard.hold_cycles;
    }
    n->rx.started = n->rx.fresh = 0;
    for (int64_t i = 0; i < n->rx.n; i++) {
        n->rx.state[i].age_cycles++;
        n->rx.state[i].still_cycles++;
        n->rx.state[i].fresh = 0;
    }
    int silent = before != STATE_INIT && n->guard.missing >= n->guard.fault_after;
    if (silent && n->guard.faulted == FAULT_NONE && !asked)
        n->guard.faulted = FAULT_INPUT_MISSING;
    int safe = settled(n), leave = asked && (safe || (silent && n->clock.trigger != TRIGGER_CLOCKED));
    int disarmed = n->guard.disarmed != 0;
    int64_t state = advance(before, n->guard.missing == 0, n->guard.faulted, leave, n->guard.gain <= 0.0 && safe,
                            disarmed);
    int waits = disarmed && state == STATE_READY;
    if (before == STATE_READY && !waits && !asked && state != STATE_FAULT)
        n->guard.pace = 0.0;
    if (n->guard.pace == 0.0 && (state == STATE_FAULT || asked || waits))
        begin_ramp(n, asked);
    if (before == STATE_FAULT || (asked && !leave) || (waits && before == state))
        n->guard.gain = n->guard.gain > n->guard.pace ? n->guard.gain - n->guard.pace : 0.0;
    if (state != before) {
        push_event(n, EVENT_STATE, state, 0.0);
        if (state == STATE_FAULT) {
            n->control.fault = n->guard.faulted;
            push_event(n, EVENT_FAULT, n->guard.faulted, 0.0);
        }
    }
    n->control.state = state;
    n->v[V_STATE] = state;
    n->v[V_FAULT] = n->guard.faulted;
    n->v[V_GAIN] = n->guard.gain;
    n->v[V_MISSING] = n->guard.missing;
    n->v[V_NMT] = NMT[state];
    tell_drive(n, state);
    watchdog(n, state);
}

static void judge_overrun(loop *n)
{
    n->guard.overruns = n->clock.behind > 0 && n->passes > n->guard.grace_passes ? n->guard.overruns + 1 : 0;
    if (n->guard.overrun_policy == OVERRUN_SKIP || n->guard.overruns < n->guard.overrun_after)
        return;
    if (n->guard.overrun_policy == OVERRUN_FAULT_AFTER) {
        if (n->guard.faulted == FAULT_NONE)
            n->guard.faulted = FAULT_OVERRUN;
    } else if (n->v[V_FALLBACK] == 0.0) {
        n->v[V_FALLBACK] = 1.0;
        push_event(n, EVENT_FALLBACK, n->clock.behind, 0.0);
    }
}

static int64_t judge_request(loop *n, int64_t count, int64_t lock, int64_t *entry)
{
    *entry = 0;
    if (count < 0 || count > SH_SLOTS)
        return REFUSAL_BAD_COUNT;
    if (lock && count > 0)
        return REFUSAL_LOCKED;
    for (int64_t i = 0; i < count; i++) {
        int64_t j = n->tuning.asked_index[i];
        double value = n->tuning.asked_value[i];
        *entry = i;
        if (j < 0 || j >= n->n_variables || n->tuning.low[j] != n->tuning.low[j])
            return REFUSAL_NO_PARAMETER;
        int finite = __builtin_fabs(value) < __builtin_inf();
        if (!(finite && n->tuning.low[j] <= value && value <= n->tuning.high[j]))
            return REFUSAL_OUT_OF_RANGE;
    }
    *entry = 0;
    return REFUSAL_ACCEPTED;
}

static void answer(loop *n, int64_t request)
{
    int64_t count = n->mail.count, lock = n->mail.lock, entry;
    memcpy(n->tuning.asked_index, n->mail_index, sizeof n->mail_index);
    memcpy(n->tuning.asked_value, n->mail_value, sizeof n->mail_value);
    if (__atomic_load_n(&n->mail.request, __ATOMIC_ACQUIRE) != request)
        return;
    int64_t refusal = judge_request(n, count, lock, &entry);
    if (refusal == REFUSAL_ACCEPTED) {
        for (int64_t i = 0; i < count; i++) {
            n->v[n->tuning.asked_index[i]] = n->tuning.asked_value[i];
            push_event(n, EVENT_TUNING, n->tuning.asked_index[i], n->tuning.asked_value[i]);
        }
    } else {
        n->control.refused++;
        push_event(n, EVENT_REFUSED, n->tuning.asked_index[entry], n->tuning.asked_value[entry]);
    }
    n->answer.cycle = n->k;
    n->answer.refusal = refusal;
    n->answer.entry = entry;
    __atomic_store_n(&n->answer.request, request, __ATOMIC_RELEASE);
}

static void tune(loop *n)
{
    while (n->tuning.done < n->tuning.n && n->tuning.schedule[n->tuning.done].cycle <= n->k) {
        int64_t j = n->tuning.schedule[n->tuning.done].place;
        n->v[j] = n->tuning.value[n->tuning.done++];
        push_event(n, EVENT_TUNING, j, n->v[j]);
    }
    int64_t request = __atomic_load_n(&n->mail.request, __ATOMIC_ACQUIRE);
    if (request != n->answer.request)
        answer(n, request);
}

static void copy_inputs(loop *n, int64_t block)
{
    int64_t first = block > 0 ? n->blocks.copies_end[block - 1] : 0;
    for (int64_t i = first; i < n->blocks.copies_end[block]; i++)
        n->v[n->blocks.copies[i].target] = n->v[n->blocks.copies[i].source];
}

static void step_blocks(loop *n, step_function **steps)
{
    double dt = n->clock.period_ns * 1e-9, *v = n->v;
    int64_t owed = n->blocks.owe_periods ? n->clock.behind : 0;
    for (int64_t k = n->k - owed; k <= n->k; k++) {
        v[V_T_S] = k * dt;
        for (int64_t b = 0; b < n->blocks.n; b++) {
            if (b == (v[V_FALLBACK] > 0.0 ? n->blocks.controller : n->blocks.fallback))
                continue;
            copy_inputs(n, b);
            const struct views *at = &n->blocks.views[b];
            n->control.stepping = b + 1;
            steps[b](v[V_T_S], dt, v + at->p, v + at->x, v + at->u, v + at->y);
        }
    }
    n->control.stepping = 0;
    for (int64_t i = 0; i < n->blocks.n_noted; i++) {
        double value = v[n->blocks.noted_index[i]];
        if (value != n->blocks.noted[i]) {
            push_event(n, EVENT_CHANGE, n->blocks.noted_index[i], value);
            n->blocks.noted[i] = value;
        }
    }
    n->timing.stepped = now(n);
}

static double within(double value, double low, double high)
{
    value = value > low ? value : low;
    return value < high ? value : high;
}

static int64_t find_not_finite(loop *n, int64_t first, int64_t past)
{
    int odd = 0;
    for (int64_t i = first; i < past; i++)
        odd |= !(__builtin_fabs(n->v[i]) < 1e300);
    if (odd)
        for (int64_t i = first; i < past; i++)
            if (!(__builtin_fabs(n->v[i]) < 1e300))
                return i;
    return -1;
}

static int check_finite(loop *n)
{
    int64_t place = -1;
    for (int64_t b = 0; b < n->blocks.n && place < 0; b++)
        place = find_not_finite(n, n->blocks.views[b].y, n->blocks.views[b].y_end);
    if (place < 0)
        place = find_not_finite(n, n->tx.first, n->tx.past);
    if (place >= 0 && n->control.odd_place == 0) {
        n->control.odd_place = place + 1;
        n->control.odd_cycle = n->k;
        n->control.odd_bits = bits_of(n->v[place]);
        push_event(n, EVENT_NOT_FINITE, place, n->v[place]);
    }
    return place >= 0;
}

static void limit(loop *n)
{
    copy_inputs(n, SH_MAX_BLOCKS);
    int odd = check_finite(n), ramping = n->v[V_STATE] >= STATE_FAULT || n->guard.pace > 0.0;
    n->v[V_CLAMPED] = 0.0;
    for (int64_t i = 0; i < n->limits.n; i++) {
        struct table *limits = &n->limits.table[i];
        double *v = &n->v[n->limits.place[i]];
        double wanted = *v, last = limits->last, safe = limits->safe;
        double rate = limits->rate, sent = limits->sent;
        if (!(__builtin_fabs(wanted) < 1e300)) {
            if (n->guard.faulted == FAULT_NONE)
                n->guard.faulted = FAULT_COMMAND_NOT_FINITE;
            wanted = last;
        }
        if (ramping)
            wanted = safe == 0.0 ? n->guard.gain * last : safe + n->guard.gain * (last - safe);
        double value = within(wanted, limits->low, limits->high);
        value = within(value, sent - rate, sent + rate);
        limits->sent = *v = value;
        if (ramping)
            continue;
        if (value != wanted) {
            n->v[V_CLAMPED] = 1.0;
            n->control.saturated++;
        }
        limits->last = value;
    }
    if (odd && n->guard.faulted == FAULT_NONE)
        n->guard.faulted = n->guard.odd_output;
}

static void send_frame(loop *n, int64_t row, int64_t counter)
{
    uint8_t *frame = n->wire.tx;
    const frame_row *about = &n->tx.frames[row];
    uint32_t word = about->can_id | about->extended << 31;
    memcpy(frame, &word, sizeof word);
    frame[4] = about->dlc;
    int64_t clamped = pack(frame + 8, about, n->tx.signals, n->v);
    if (clamped > 0) {
        n->v[V_CLAMPED] = 1.0;
        n->control.saturated += clamped;
    }
    protect(frame + 8, about, counter);
    if (put_frame(&n->wire)) {
        n->control.sent++;
    } else {
        n->control.send_errors++;
        n->control.bus_errno = n->wire.errno_;
    }
    push_frame(n, frame, 0, 0);
}

static void transmit(loop *n)
{
    for (int64_t row = 0; row < n->tx.n; row++) {
        int64_t every = n->tx.frames[row].every_n;
        if (n->passes % every == 0)
            send_frame(n, row, n->passes / every + n->tx.kind[row].is_sync);
    }
    n->timing.sent = now(n);
}

static void announce(loop *n)
{
    n->v[V_NMT] = NMT[(int64_t)n->v[V_STATE]];
    copy_inputs(n, SH_MAX_BLOCKS);
    for (int64_t row = 0; row < n->tx.n; row++)
        if (n->tx.kind[row].is_heartbeat)
            send_frame(n, row, 0);
}

static void request_first_sample(loop *n)
{
    for (int64_t row = 0; row < n->tx.n; row++)
        if (n->tx.kind[row].is_sync)
            send_frame(n, row, 0);
}

static void note_timing(loop *n)
{
    double *v = n->v + V_TIMING_AT;
    v[0] = 0.001 * (n->clock.wake - n->clock.deadline);
    v[1] = 0.001 * (n->timing.received - n->clock.wake);
    v[2] = 0.001 * (n->timing.stepped - n->timing.received);
    v[3] = 0.001 * (n->timing.sent - n->timing.stepped);
    v[4] = 0.001 * n->timing.publish_ns;
    for (size_t i = 0; i < sizeof COUNTERS / sizeof *COUNTERS; i++)
        v[5 + i] = ((const int64_t *)&n->control)[COUNTERS[i]];
    n->v[V_REFUSED] = n->control.refused;
    n->v[V_WALL] = 1e-9 * (n->clock.wake + n->clock.wall_offset_ns);
}

/* ----------------------------------------------------------------- executive/loop/timing.py -------- */

static const double POINTS[] = {0.5, 0.99, 0.999};

static int64_t bucket(int64_t v)
{
    if (v < 16)
        return v > 0 ? v : 0;
    int64_t e = 63 - __builtin_clzll(v), i = 16 + 8 * (e - 4) + ((v >> (e - 3)) & 7);
    return e <= 40 && i < SH_BUCKETS ? i : SH_BUCKETS - 1;
}

static int64_t bucket_end(int64_t i)
{
    return i < 16 ? i : ((8 + (i - 16) % 8 + 1) << (4 + (i - 16) / 8 - 3)) - 1;
}

static void note_latest(loop *n)
{
    int64_t late = n->timing.stage_ns[STAGE_WAKE_LATE];
    struct latest *least = n->latest;
    for (int64_t i = 1; i < SH_LATEST; i++)
        if (n->latest[i].stage_ns[STAGE_WAKE_LATE] < least->stage_ns[STAGE_WAKE_LATE])
            least = &n->latest[i];
    if (late <= n->clock.late_ns || late <= least->stage_ns[STAGE_WAKE_LATE])
        return;
    least->cycle = n->k;
    memcpy(least->stage_ns, n->timing.stage_ns, sizeof n->timing.stage_ns);
    for (int i = 0; i < 4; i++)
        least->usage[i] = n->timing.usage[USAGE[i]] - n->timing.usage_before[i];
    push_event(n, EVENT_LATE, late, 0.0);
}

static int64_t percentile(loop *n, int64_t stage, double share)
{
    double wanted = share * n->stages[stage].count;
    int64_t seen = 0, most = n->stages[stage].most;
    for (int64_t i = 0; i < SH_BUCKETS; i++) {
        seen += n->histogram[stage][i];
        if (seen >= wanted)
            return bucket_end(i) < most ? bucket_end(i) : most;
    }
    return most;
}

static void show(loop *n)
{
    static const int64_t shown[] = {STAGE_WAKE_LATE, STAGE_WORK};
    double *v = n->v + V_STATISTICS_AT;
    for (int j = 0; j < 2; j++) {
        const struct stages *stage = &n->stages[shown[j]];
        *v++ = 0.001 * stage->least;
        *v++ = 0.001 * stage->total / (stage->count ? stage->count : 1);
        *v++ = 0.001 * stage->most;
        for (int i = 0; i < 3; i++)
            *v++ = 0.001 * percentile(n, shown[j], POINTS[i]);
    }
}

static void count(loop *n)
{
    if (n->v[V_RESET] >= 0.5) {
        n->v[V_RESET] = 0.0;
        memset(n->stages, 0, sizeof n->stages);
        memset(n->histogram, 0, sizeof n->histogram);
        memset(n->latest, 0, sizeof n->latest);
        for (int64_t s = 0; s < SH_STAGES; s++)
            n->stages[s].least = 1LL << 62;
    }
    int64_t times[SH_STAGES] = {
        n->clock.wake - n->clock.deadline, n->timing.received - n->clock.wake, n->timing.stepped - n->timing.received,
        n->timing.sent - n->timing.stepped, n->timing.done - n->timing.sent, n->timing.done - n->clock.wake,
    };
    memcpy(n->timing.stage_ns, times, sizeof times);
    for (int64_t s = 0; s < SH_STAGES; s++) {
        int64_t t = times[s];
        struct stages *stage = &n->stages[s];
        stage->count++;
        stage->total += t;
        stage->least = t < stage->least ? t : stage->least;
        stage->most = t > stage->most ? t : stage->most;
        n->histogram[s][bucket(t)]++;
    }
    getrusage(RUSAGE_THREAD, (struct rusage *)n->timing.usage);
    note_latest(n);
    for (int i = 0; i < 4; i++)
        n->timing.usage_before[i] = n->timing.usage[USAGE[i]];
    if (n->passes % TIMING_UPDATE_PASSES == 0)
        show(n);
}

/* ------------------------------------------------------------------ executive/loop/cycle.py -------- */

static int one_pass(loop *n, step_function **steps)
{
    set_time(n);
    if (paced(n)) {
        wait(n);
        receive(n);
    } else {
        receive(n);
        if (n->clock.trigger == TRIGGER_CLOCKED && n->passes == n->clock.arm_pass) {
            arm(n);
            wait(n);
        } else {
            n->clock.deadline = n->clock.wake = n->timing.received;
        }
        n->timing.received = n->clock.wake;
    }
    judge_overrun(n);
    supervise(n);
    if (n->v[V_STATE] == STATE_STOP || n->guard.faulted == FAULT_PEER_SILENT)
        return 0;
    tune(n);
    step_blocks(n, steps);
    limit(n);
    transmit(n);
    note_timing(n);
    publish(n);
    push_record(n);
    n->control.passes = n->passes + 1;
    n->control.cycle = n->k;
    n->timing.done = now(n);
    n->timing.publish_ns = n->timing.done - n->timing.sent;
    if (runs(n))
        count(n);
    next_cycle(n);
    return n->k < n->guard.cycles || !settled(n);
}

static void finish(loop *n)
{
    set_time(n);
    if (n->v[V_STATE] != STATE_STOP)
        push_event(n, EVENT_STATE, STATE_STOP, 0.0);
    n->v[V_STATE] = STATE_STOP;
    n->v[V_NMT] = NMT[STATE_STOP];
    n->guard.gain = 0.0;
    tell_drive(n, STATE_STOP);
    n->control.state = STATE_STOP;
    if (n->tx.last_word == LASTWORD_ALL_FRAMES) {
        limit(n);
        transmit(n);
    } else {
        announce(n);
    }
    if (n->guard.faulted != FAULT_NONE && n->control.fault == FAULT_NONE) {
        n->control.fault = n->guard.faulted;
        push_event(n, EVENT_FAULT, n->guard.faulted, 0.0);
    }
    publish(n);
    __atomic_store_n(&n->control.done, 1, __ATOMIC_RELEASE);
}

static int n_done(loop *n)
{
    return n->control.done != 0;
}

static void pass_or_finish(loop *n, step_function **steps)
{
    if (!n_done(n) && !one_pass(n, steps))
        finish(n);
}

static int wait_for_peer(loop *n)
{
    n->wire.muted = n->wire.in_turn;
    while (!stopping(n)) {
        int result = get_frame(&n->wire, 1);
        if (result == ARRIVAL_FAILED) {
            n->control.bus_errno = n->wire.errno_;
            n->guard.faulted = FAULT_BUS_FAILED;
            return 0;
        }
        int64_t row = result == ARRIVAL_FRAME ? take_frame(n) : -1;
        int known = row >= 0 && n->rx.role[row].peer != 0;
        if (known) {
            n->meeting.heard |= 1; /* of one peer */
            n->wire.muted = 0;
        }
        if (known || result == ARRIVAL_NOTHING)
            announce(n);
        if (known)
            return 1;
    }
    return 0;
}

int64_t run(loop *n, step_function **steps)
{
    if (n->meeting.seeks_below && wait_for_peer(n))
        request_first_sample(n);
    while (one_pass(n, steps))
        ;
    finish(n);
    return n->passes;
}

/* --------------------------------------------------------------- executive/loop/exchange.py -------- */

static void carry(struct wire *from, struct wire *to)
{
    int64_t room = WIRE_QUEUE_FRAMES - (to->inbox_put - to->inbox_taken);
    int64_t moved = from->outbox_put < room ? from->outbox_put : room;
    for (int64_t i = 0; i < moved; i++)
        memcpy(to->inbox[to->inbox_put++ % WIRE_QUEUE_FRAMES], from->outbox[i], WIRE_CLASSIC_BYTES);
    memmove(from->outbox, from->outbox[moved], (from->outbox_put - moved) * WIRE_FRAME_BYTES);
    from->outbox_put -= moved;
}

int64_t run_virtual(loop *executive, step_function **laws, loop *plant, step_function **models,
                    int64_t cycles)
{
    if (executive->passes == 0) {
        announce(plant);
        carry(&plant->wire, &executive->wire);
        wait_for_peer(executive);
        request_first_sample(executive);
        carry(&executive->wire, &plant->wire);
        one_pass(plant, models);
    }
    for (int64_t i = 0; i < cycles; i++) {
        carry(&plant->wire, &executive->wire);
        int more = one_pass(executive, laws);
        if (more || executive->k >= executive->guard.cycles) {
            carry(&executive->wire, &plant->wire);
            pass_or_finish(plant, models);
        }
        if (!more) {
            finish(executive);
            carry(&executive->wire, &plant->wire);
            pass_or_finish(plant, models);
            if (!n_done(plant))
                finish(plant);
            return 0;
        }
    }
    return 1;
}

/* ------------------------------------------------- the drivers, as in tools/dev/bench/cycle.py ---- */

static void put_back(loop *n)
{
    n->record_taken[0] = n->record_ends.head;
    n->frame_taken[0] = n->frame_ends.head;
    n->event_taken[0] = n->event_ends.head;
}

void drive_memory(loop *n, step_function **steps, const uint8_t (*frames)[16], const int64_t *ends,
                  int64_t cycles, int64_t repeats)
{
    for (int64_t r = 0; r < repeats; r++) {
        int64_t first = 0;
        put_back(n);
        for (int64_t k = 0; k < cycles; k++) {
            for (int64_t i = first; i < ends[k]; i++)
                memcpy(n->wire.inbox[n->wire.inbox_put++ % WIRE_QUEUE_FRAMES], frames[i], 16);
            first = ends[k];
            n->clock.now_ns = n->k * n->clock.period_ns;
            n->wire.outbox_put = 0;
            one_pass(n, steps);
        }
    }
}

void drive_bus(loop *n, step_function **steps, struct wire *peer, const uint8_t (*frames)[16],
               const int64_t *ends, int64_t cycles, int64_t *took_ns)
{
    int64_t first = 0;
    put_back(n);
    for (int64_t k = 0; k < cycles; k++) {
        for (int64_t i = first; i < ends[k]; i++) {
            memcpy(peer->tx, frames[i], 16);
            put_frame(peer);
        }
        first = ends[k];
        int64_t began = now(n);
        n->clock.deadline = began - n->clock.period_ns / 2;
        one_pass(n, steps);
        took_ns[k] = now(n) - began;
    }
}

void drive_publish(loop *n, int64_t repeats)
{
    for (int64_t i = 0; i < repeats; i++)
        publish(n);
}

void drive_copy(loop *n, int64_t repeats)
{
    for (int64_t i = 0; i < repeats; i++) {
        memcpy(n->snapshot, n->v, n->n_variables * sizeof *n->v);
        __asm__ volatile("" ::: "memory");
    }
}
