#include "device.h"

#include "rig.h"
#include "supervisor.h"
#if PCPC_XCP
#include "xcp.h"
#endif

static struct device {
    device_send send;
    uint32_t cycles;
    uint32_t k; /* periods since the begin; `passes`: cycles really done */
    uint32_t passes;
    state_t state;
    uint32_t fault;
    double gain; /* share of the command that is sent, falling by `pace` */
    double pace;
    uint32_t missing; /* cycles in a row without complete valid input */
    uint32_t fresh; /* awaited frames that were used, and those that came, in this cycle */
    uint32_t came;
    uint32_t quick;
    uint32_t repeats;
    uint32_t repeats_since;
    double told_error;
    bool silent;
    bool stopped; /* the plant has ended */
    bool over;
} d;

static struct {
    double wanted; /* last value of a command that was not on a ramp, and the value sent before */
    double sent;
} command[RIG_LIMITS + 1u];

static receiver_t heard[RIG_HEARD];

/* -------------------------------------------------------------------------------- what is sent */

static void send_row(uint32_t row, uint32_t counter)
{
#if PCPC_FD
    frame_t frame = {rig_sent[row].id, rig_sent[row].n, {0u}, rig_sent[row].flags};
#else
    frame_t frame = {rig_sent[row].id, rig_sent[row].n, {0u}};
#endif
    uint32_t clamped = rig_pack(row, frame.data);
    if (clamped > 0u) {
        rig.supervisor.saturated = 1.0;
        rig.counts.saturated_values += clamped;
    }
    protect(frame.data, &rig_sent[row], counter);
    d.send(&frame);
    rig.counts.frames_sent += 1u;
}

static void send_heartbeat(void)
{
    rig.supervisor.nmt = DOES[d.state].heartbeat;
    rig_send();
    for (uint32_t row = 0u; row < RIG_SENT; row++) {
        if (rig_sent[row].heartbeat) {
            send_row(row, 0u);
        }
    }
}

/* Slow frames, frames of every cycle, SYNC: the order of the rows. */
static void transmit(void)
{
    for (uint32_t row = 0u; row < RIG_SENT; row++) {
        const frame_info *frame = &rig_sent[row];
        if (frame->emergency) {
            if (rig.supervisor.error_code != d.told_error) {
                d.told_error = rig.supervisor.error_code;
                send_row(row, 0u);
            }
        } else if ((d.passes % frame->every_n) == 0u) {
            send_row(row, (d.passes / frame->every_n) + (frame->sync ? 1u : 0u));
        } else {
            /* not its turn */
        }
    }
}

/* -------------------------------------------------------------------------------- the commands */

static double size_of(double value)
{
    return (value < 0.0) ? -value : value;
}

static double clip(double value, double low, double high)
{
    double least = (value > low) ? value : low;
    return (least < high) ? least : high;
}

static bool all_finite(const double *values, uint32_t n)
{
    bool finite = true;
    for (uint32_t i = 0u; i < n; i++) {
        finite = finite && (size_of(values[i]) < FINITE);
    }
    return finite;
}

/* Whether every command may be its safe value in the next frame. */
static bool settled(void)
{
    const uint32_t n = RIG_LIMITS;
    for (uint32_t i = 0u; i < n; i++) {
        if (size_of(command[i].sent - rig_limits[i].safe) > rig_limits[i].rate) {
            return false;
        }
    }
    return true;
}

/* The pace of the ramp is that of the slowest command. */
static void begin_ramp(void)
{
    const uint32_t n = RIG_LIMITS;
    d.pace = RIG_RAMP_STEP;
    if (d.quick != (uint32_t)QUICK_NONE) {
        d.pace = RIG_QUICK_STEP;
        d.quick = (uint32_t)QUICK_BEGUN;
    }
    for (uint32_t i = 0u; i < n; i++) {
        double way = size_of(command[i].wanted - rig_limits[i].safe);
        if ((way * d.pace) > rig_limits[i].rate) {
            d.pace = rig_limits[i].rate / way;
        }
    }
}

static void quick_stop(uint32_t fault)
{
    if (d.fault == (uint32_t)FAULT_NONE) {
        d.fault = fault;
    }
    if (d.quick == (uint32_t)QUICK_NONE) {
        d.quick = (uint32_t)QUICK_ASKED;
    }
}

static void limit_one(uint32_t i, bool waits, bool ramping)
{
    const limit_t *limit = &rig_limits[i];
    double last = command[i].wanted;
    double safe = limit->safe;
    double wanted = *limit->value;
    bool rising = d.gain < 1.0;
    if (!(size_of(wanted) < FINITE)) {
        if (d.fault == (uint32_t)FAULT_NONE) {
            d.fault = (uint32_t)FAULT_COMMAND_NOT_FINITE;
        }
        wanted = last;
    }
    if (waits) {
        wanted = safe;
    }
    if (ramping) {
        wanted = (safe == 0.0) ? (d.gain * last) : (safe + (d.gain * (last - safe)));
    } else if (rising) {
        wanted = safe + (d.gain * (wanted - safe));
    } else {
        /* as the law wants it */
    }
    double value = clip(wanted, limit->low, limit->high);
    value = clip(value, command[i].sent - limit->rate, command[i].sent + limit->rate);
    command[i].sent = value;
    *limit->value = value;
    if (!ramping) {
        if (value != wanted) {
            rig.supervisor.saturated = 1.0;
            rig.counts.saturated_values += 1u;
        }
        command[i].wanted = value;
        if (rising && (d.gain > 0.0)) {
            command[i].wanted = safe + ((value - safe) / d.gain);
        }
    }
}

/* Carry what the blocks say into what is sent: finite, within range and rate, or on a ramp to safe. */
static void limit_commands(void)
{
    const uint32_t n = RIG_LIMITS;
    rig_send();
    bool odd = !rig_finite(all_finite);
    bool waits = !DOES[d.state].sends;
    bool ramping = DOES[d.state].ramps || (d.pace > 0.0);
    rig.supervisor.saturated = 0.0;
    for (uint32_t i = 0u; i < n; i++) {
        limit_one(i, waits, ramping);
    }
    if (odd && (d.fault == (uint32_t)FAULT_NONE)) {
        d.fault = (uint32_t)FAULT_OUTPUT_NOT_FINITE;
    }
}

/* ------------------------------------------------------------------------------ the supervisor */

static state_t advance(bool fresh, bool leave, bool ramped)
{
    condition_t condition = CONDITION_MISSED;
    if (leave) {
        condition = CONDITION_STOP_REQUEST;
    } else if (d.state == STATE_FAULT) {
        condition = ramped ? CONDITION_RAMPED : CONDITION_NONE;
    } else if (d.fault != (uint32_t)FAULT_NONE) {
        condition = CONDITION_LOSS;
    } else if (fresh) {
        condition = CONDITION_FRESH;
    } else {
        /* missed */
    }
    return NEXT[d.state][condition];
}

static void count_missing(void)
{
    bool running = DOES[d.state].runs;
    if (d.fresh >= RIG_AWAITED) {
        d.missing = 0u;
    } else {
        d.missing += 1u;
        rig.counts.held_cycles += running ? 1u : 0u;
        rig.counts.stale_cycles += (running && (d.missing > RIG_HOLD_CYCLES)) ? 1u : 0u;
    }
    d.came = 0u;
    d.fresh = 0u;
    for (uint32_t row = 0u; row < RIG_HEARD; row++) {
        heard[row].still_cycles += 1u;
        heard[row].fresh = false;
    }
}

/* The word of CiA 402's state. */
static power_t drive_state(void)
{
    if (d.state == STATE_STOP) {
        return POWER_SWITCH_ON_DISABLED;
    }
    if (d.state == STATE_FAULT) {
        return ((d.gain <= 0.0) && settled()) ? POWER_FAULT : POWER_FAULT_REACTION_ACTIVE;
    }
    if (d.state == STATE_INIT) {
        return POWER_NOT_READY;
    }
    if (d.pace > 0.0) {
        return POWER_QUICK_STOP_ACTIVE;
    }
    if (d.state == STATE_READY) {
        return POWER_READY_TO_SWITCH_ON;
    }
    return (d.gain >= 1.0) ? POWER_OPERATION_ENABLED : POWER_SWITCHED_ON;
}

static void tell(void)
{
    uint32_t word = (uint32_t)drive_state();
    word |= (d.state == STATE_HOLD) ? WARNING : 0u;
    word |= (rig.supervisor.saturated != 0.0) ? LIMITED : 0u;
    rig.supervisor.state = (double)(uint32_t)d.state;
    rig.supervisor.fault = (double)d.fault;
    rig.supervisor.gain = d.gain;
    rig.supervisor.missing_cycles = (double)d.missing;
    rig.supervisor.nmt = DOES[d.state].heartbeat;
    rig.supervisor.status_word = (double)word;
    rig.supervisor.error_code = ERRORS[d.fault].code;
    rig.supervisor.error_register = ERRORS[d.fault].error_register;
}

static void supervise(void)
{
    state_t before = d.state;
    bool asked = (d.cycles != 0u) && (d.k >= d.cycles);
    count_missing();
    bool silent = DOES[before].expects && (d.missing >= RIG_FAULT_AFTER);
    if (silent && (d.fault == (uint32_t)FAULT_NONE) && !asked) {
        d.fault = (uint32_t)FAULT_INPUT_MISSING;
    }
    if (rig_estop()) {
        quick_stop((uint32_t)FAULT_EMERGENCY_STOP);
    }
    bool safe = settled();
    bool leave = asked && safe;
    bool ramped = (d.gain <= 0.0) && safe && !RIG_WAITS_IN_FAULT;
    d.state = advance(d.missing == 0u, leave, ramped);
    bool ramps = DOES[d.state].ramps || asked;
    if ((before == STATE_READY) && !ramps) {
        d.pace = 0.0;
    }
    if (ramps && ((d.pace == 0.0) || (d.quick == (uint32_t)QUICK_ASKED))) {
        begin_ramp();
    }
    if (DOES[before].ramps || (asked && !leave)) {
        d.gain = (d.gain > d.pace) ? (d.gain - d.pace) : 0.0;
    } else if (!ramps && DOES[d.state].sends) {
        d.gain = clip(d.gain + RIG_RAMP_STEP, 0.0, 1.0);
    } else {
        /* as it was */
    }
    tell();
}

/* ------------------------------------------------------------------------------- what is heard */

static void note_repeat(void)
{
    if ((d.repeats == 0u) || ((d.passes - d.repeats_since) >= REPEATED_CYCLES)) {
        d.repeats_since = d.passes;
        d.repeats = 0u;
    }
    d.repeats += 1u;
    if ((d.repeats >= REPEATED_FRAMES) && (d.fault == (uint32_t)FAULT_NONE)) {
        d.fault = (uint32_t)FAULT_REPEATED_INPUT;
    }
}

static void take(uint32_t row, const uint8_t data[ROOM], uint8_t n)
{
    const frame_info *frame = &rig_heard[row];
    bool before = heard[row].fresh;
    uint32_t awaited = frame->awaited ? 1u : 0u;
    switch (judge(data, n, frame, &heard[row], &rig.counts.frames_lost)) {
    case USED:
    case USED_SOME_LOST:
        rig_unpack(row, data);
        rig.counts.frames_received += 1u;
        if (row == RIG_STOP_ROW) {
            quick_stop((uint32_t)FAULT_STOP_FRAME);
        }
        if (!before) {
            d.came += awaited;
            d.fresh += awaited;
        }
        break;
    case WRONG_SEQUENCE: /* it came; the next one will be trusted */
        rig.counts.wrong_sequence += 1u;
        d.came += awaited;
        break;
    case REPEATED:
        rig.counts.frames_repeated += 1u;
        if (frame->awaited) {
            note_repeat();
        }
        break;
    case WRONG_CRC:
    default:
        rig.counts.crc_errors += 1u;
        break;
    }
}

void device_frame(uint32_t id, const uint8_t data[ROOM], uint8_t n)
{
    uint8_t whole[ROOM] = {0u};
    for (uint8_t i = 0u; (i < n) && (i < ROOMu); i++) {
        whole[i] = data[i];
    }
    for (uint32_t row = 0u; row < RIG_HEARD; row++) {
        if (rig_heard[row].id == id) {
            take(row, whole, n);
            if (rig_heard[row].heartbeat && (n > 0u)) { /* one with 4 may be an earlier run's end */
                bool stopped = whole[0] == (uint8_t)HEARTBEAT_STOPPED;
                d.stopped = d.stopped || (device_met() && stopped);
                heard[row].met = heard[row].met || !stopped;
            }
        }
    }
}

/* ----------------------------------------------------------------------------------- the cycle */

static void finish(void)
{
    d.state = STATE_STOP;
    d.gain = 0.0;
    tell();
    limit_commands();
    transmit();
    d.over = true;
}

bool device_init(uint32_t cycles, device_send send)
{
    const uint32_t n = RIG_LIMITS;
    d = (struct device){0};
    d.send = send;
    d.cycles = cycles;
    d.gain = 1.0;
    for (uint32_t row = 0u; row < RIG_HEARD; row++) {
        heard[row] = (receiver_t){-1, 0u, false, false};
    }
    bool right = rig_init() == 0;
    for (uint32_t i = 0u; i < n; i++) {
        command[i].wanted = rig_limits[i].safe;
        command[i].sent = rig_limits[i].safe;
    }
    rig.supervisor.gain = 1.0;
    return right;
}

void device_greet(void)
{
    send_heartbeat();
}

bool device_met(void)
{
    bool met = false;
    for (uint32_t row = 0u; row < RIG_HEARD; row++) { /* all plants, and at least one */
        if (rig_heard[row].heartbeat && !heard[row].met) {
            return false;
        }
        met = met || rig_heard[row].heartbeat;
    }
    return met;
}

void device_sync(void)
{
    send_heartbeat();
    for (uint32_t row = 0u; row < RIG_SENT; row++) {
        if (rig_sent[row].sync) {
            send_row(row, 0u);
        }
    }
}

bool device_ready(void)
{
    return d.came >= RIG_AWAITED;
}

void device_cycle(uint32_t periods)
{
    if (d.over) {
        return;
    }
    if (d.passes > 0u) {
        d.k += periods;
    }
    supervise();
    if ((d.state == STATE_STOP) || d.silent) {
        finish();
        return;
    }
    rig_tune(d.k);
#if PCPC_XCP
    xcp_written(d.k);
#endif
    rig_step((double)d.k * RIG_PERIOD_S);
    limit_commands();
    transmit();
    rig_publish(d.passes);
#if PCPC_XCP
    xcp_measure(d.k);
#endif
    d.passes += 1u;
    if ((d.cycles != 0u) && ((d.k + 1u) >= d.cycles) && settled()) {
        d.k += 1u;
        finish();
    }
}

void device_alone(void)
{
    if (d.fault == (uint32_t)FAULT_NONE) {
        d.fault = (uint32_t)FAULT_PEER_SILENT;
    }
    d.silent = true;
    device_cycle(1u);
}

bool device_over(void)
{
    return d.over || d.stopped;
}

uint32_t device_fault(void)
{
    return d.fault;
}
