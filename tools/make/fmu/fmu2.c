/* FMI 2.0 for co-simulation around a block: `plant.h` has the block, `fmu_block.h` its variables.
 *
 * A value reference is the place of a double in `values`: parameters, states, inputs, outputs. The
 * communication step is the rig's period, and time is counted in steps. Call 0 of the block, which
 * samples t = 0, waits until an output is asked for or a step is made, so that inputs are there.
 */

#include <stdint.h>
#include <string.h>

#include "fmi2Functions.h"

#include "fmu_block.h"
#include "pcpc_math.h"

enum { INTERNAL, PARAMETER, STATE, INPUT, OUTPUT };

typedef struct {
    plant_values values;
    uint64_t cycle;
    int32_t begun;   /* call 0 was made */
    int32_t running; /* initialisation is over */
} plant_state;

typedef struct {
    plant_state now;
    fmi2CallbackFunctions callbacks;
    char name[64];
} plant_fmu;

/* How far a communication point may be from the time of a cycle. */
#define NEAR_S (1e-6 * PLANT_PERIOD_S)

static const uint8_t roles[PLANT_VALUES] = PLANT_ROLES;

static fmi2Status refuse(const plant_fmu *fmu, const char *why)
{
    if (fmu->callbacks.logger != NULL) {
        fmu->callbacks.logger(fmu->callbacks.componentEnvironment, fmu->name, fmi2Error,
            "logStatusError", why);
    }
    return fmi2Error;
}

static void begin(plant_fmu *fmu)
{
    memset(&fmu->now, 0, sizeof(fmu->now));
    plant_begin(&fmu->now.values);
}

static void call(plant_fmu *fmu)
{
    plant_call((double)fmu->now.cycle * PLANT_PERIOD_S, PLANT_PERIOD_S, &fmu->now.values);
    fmu->now.begun = 1;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
    const fmi2String categories[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
    fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
    fmi2Boolean logging)
{
    plant_fmu *fmu;
    (void)resources;
    (void)visible;
    (void)logging;
    if (functions == NULL || functions->allocateMemory == NULL || functions->freeMemory == NULL) {
        return NULL;
    }
    fmu = functions->allocateMemory(1U, sizeof(plant_fmu));
    if (fmu == NULL) {
        return NULL;
    }
    fmu->callbacks = *functions;
    strncpy(fmu->name, (name == NULL) ? "" : name, sizeof(fmu->name) - 1U);
    if (type != fmi2CoSimulation) {
        (void)refuse(fmu, "This FMU is for co-simulation.");
    } else if (guid == NULL || strcmp(guid, PLANT_GUID) != 0) {
        (void)refuse(fmu, "The GUID is not that of this FMU.");
    } else if (plant_selftest() != 0 || pcpc_selftest() != 0) {
        (void)refuse(fmu, "Compiled with other bits: -ffp-contract=off is needed.");
    } else {
        begin(fmu);
        return fmu;
    }
    functions->freeMemory(fmu);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    plant_fmu *fmu = c;
    if (fmu != NULL) {
        fmu->callbacks.freeMemory(fmu);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
    fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    return (start == 0.0) ? fmi2OK : refuse(c, "Time begins with 0.");
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    ((plant_fmu *)c)->now.running = 1;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    begin(c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    plant_fmu *fmu = c;
    for (size_t i = 0U; i < n; i += 1U) {
        if (vr[i] >= PLANT_VALUES || roles[vr[i]] == INTERNAL) {
            return refuse(fmu, "No variable has this value reference.");
        }
        if (roles[vr[i]] == OUTPUT && fmu->now.running != 0 && fmu->now.begun == 0) {
            call(fmu);
        }
        value[i] = ((const double *)&fmu->now.values)[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Real value[])
{
    plant_fmu *fmu = c;
    for (size_t i = 0U; i < n; i += 1U) {
        uint8_t role = (vr[i] < PLANT_VALUES) ? roles[vr[i]] : (uint8_t)INTERNAL;
        if (role == INTERNAL || role == OUTPUT) {
            return refuse(fmu, "This variable cannot be set.");
        }
        if (role == STATE && fmu->now.running != 0) {
            return refuse(fmu, "A state can be set before it runs only.");
        }
        ((double *)&fmu->now.values)[vr[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_earlier_state)
{
    plant_fmu *fmu = c;
    const double off = t - (double)fmu->now.cycle * PLANT_PERIOD_S;
    const double longer = h - PLANT_PERIOD_S;
    (void)no_earlier_state;
    if (!(-NEAR_S <= off && off <= NEAR_S)) {
        return refuse(fmu, "A step has to begin where the one before ended.");
    }
    if (!(-NEAR_S <= longer && longer <= NEAR_S)) {
        return refuse(fmu, "The communication step has to be " PLANT_PERIOD_TEXT " s.");
    }
    if (fmu->now.begun == 0) {
        call(fmu);
    }
    fmu->now.cycle += 1U;
    call(fmu);
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    plant_fmu *fmu = c;
    if (*state == NULL) {
        *state = fmu->callbacks.allocateMemory(1U, sizeof(plant_state));
    }
    if (*state == NULL) {
        return refuse(fmu, "No memory for the state.");
    }
    memcpy(*state, &fmu->now, sizeof(plant_state));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(&((plant_fmu *)c)->now, state, sizeof(plant_state));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state != NULL) {
        ((plant_fmu *)c)->callbacks.freeMemory(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(plant_state);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t n)
{
    if (n < sizeof(plant_state)) {
        return refuse(c, "The buffer is too small for the state.");
    }
    memcpy(bytes, state, sizeof(plant_state));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t n,
    fmi2FMUstate *state)
{
    plant_fmu *fmu = c;
    if (n != sizeof(plant_state)) {
        return refuse(c, "These bytes are no state of this FMU.");
    }
    *state = fmu->callbacks.allocateMemory(1U, sizeof(plant_state));
    if (*state == NULL) {
        return refuse(fmu, "No memory for the state.");
    }
    memcpy(*state, bytes, n);
    return fmi2OK;
}

/* What has no meaning here: all variables are real, none has a derivative, no step is pending. */

#define NONE(c) return refuse((c), "This FMU has nothing of that kind.")

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    fmi2Integer value[])
{
    (void)vr;
    (void)value;
    if (n == 0U) {
        return fmi2OK;
    }
    NONE(c);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    fmi2Boolean value[])
{
    return fmi2GetInteger(c, vr, n, value);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    fmi2String value[])
{
    (void)value;
    return fmi2GetInteger(c, vr, n, NULL);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Integer value[])
{
    (void)value;
    return fmi2GetInteger(c, vr, n, NULL);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Boolean value[])
{
    return fmi2SetInteger(c, vr, n, value);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2String value[])
{
    (void)value;
    return fmi2GetInteger(c, vr, n, NULL);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
    size_t n_unknown, const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[],
    fmi2Real d_unknown[])
{
    (void)unknown;
    (void)n_unknown;
    (void)known;
    (void)n_known;
    (void)d_known;
    (void)d_unknown;
    NONE(c);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr;
    (void)n;
    (void)order;
    (void)value;
    NONE(c);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Integer order[], fmi2Real value[])
{
    (void)vr;
    (void)n;
    (void)order;
    (void)value;
    NONE(c);
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    NONE(c);
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind;
    (void)value;
    NONE(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    plant_fmu *fmu = c;
    if (kind == fmi2LastSuccessfulTime) {
        *value = (double)fmu->now.cycle * PLANT_PERIOD_S;
        return fmi2OK;
    }
    NONE(c);
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind;
    (void)value;
    NONE(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)kind;
    (void)value;
    NONE(c);
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind;
    (void)value;
    NONE(c);
}
