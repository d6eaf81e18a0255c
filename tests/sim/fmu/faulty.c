/* An FMU that fails on demand: x' = u, y = gain * x, and from the time `at` on what `mode` says:
 *   0 nothing  1 it hangs  2 it crashes  3 NaN  4 Error, with a message  5 Fatal  6 it ends the simulation
 *   7 every step takes 30 ms  8 (FMI 3) it returns early for ever  9 Discard  10 Error once in a process
 *   11 (FMI 3) an event in the middle of each step, for which it returns early
 * Written after FMI 2.0.4 and 3.0.2 for the tests of Rigor; it needs no header of FMI. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <time.h>

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { VR_TIME, VR_U, VR_Y, VR_MODE, VR_AT, VR_GAIN, VR_COUNT, VR_ON, VR_N, VR_V, VR_W };

typedef void (*logger3)(void *, int, const char *, const char *);
typedef void (*logger2)(void *, const char *, int, const char *, const char *, ...);

typedef struct Model {
  struct Model *next;
  double t, x, u, at, gain;
  int mode, count;
  bool on, configuring, initialised, in_event, had_event; /* the modes of FMI 3 */
  uint64_t n; /* size of v and w = 2 v */
  double v[8];
  void *environment;
  void (*logger)(void);
} Model;

/* Those that are not freed after Fatal are not lost. */
static Model *all;

static void release(Model *m) {
  Model **at = &all;
  while (*at && *at != m) at = &(*at)->next;
  if (*at) *at = m->next;
  free(m);
}

static Model *make(void *environment, void (*logger)(void)) {
  Model *m = calloc(1, sizeof *m);
  m->gain = 1;
  m->n = 2;
  m->next = all;
  all = m;
  m->environment = environment;
  m->logger = logger;
  return m;
}

static void say(Model *m, int status, const char *text) {
#if FMI_VERSION == 2
  if (m->logger) ((logger2)m->logger)(m->environment, "faulty", status, "logStatusError", "%s", text);
#else
  if (m->logger) ((logger3)m->logger)(m->environment, status, "logStatusError", text);
#endif
}

static int do_step(Model *m, double t, double h, bool *terminate) {
  const int mode = t + h > m->at - 1e-9 ? m->mode : 0;
  m->x += m->u * h;
  m->t = t + h;
  m->count++;
  switch (mode) {
    case 1:
      for (;;) {
        struct timespec nap = {1, 0};
        nanosleep(&nap, NULL);
      }
    case 2:
      *(volatile int *)0 = 1;
      break;
    case 3:
      m->x = NAN;
      break;
    case 4:
      say(m, ERROR, "the valve is stuck");
      return ERROR;
    case 5:
      return FATAL;
    case 6:
      *terminate = true;
      break;
    case 7: {
      struct timespec nap = {0, 30000000};
      nanosleep(&nap, NULL);
      break;
    }
    case 9:
      return DISCARD;
    case 10:
      /* A library that is loaded anew has forgotten; the process has not. */
      if (getenv("RIGOR_FAULTY_FMU")) break;
      setenv("RIGOR_FAULTY_FMU", "failed", 1);
      return ERROR;
  }
  return OK;
}

static int get_real(Model *m, const uint32_t *vr, size_t n, double *value) {
  for (size_t i = 0; i < n; i++) switch (vr[i]) {
      case VR_TIME: value[i] = m->t; break;
      case VR_U: value[i] = m->u; break;
      case VR_Y: value[i] = m->gain * m->x; break;
      case VR_AT: value[i] = m->at; break;
      case VR_GAIN: value[i] = m->gain; break;
      default: return ERROR;
    }
  return OK;
}
static int set_real(Model *m, const uint32_t *vr, size_t n, const double *value) {
  for (size_t i = 0; i < n; i++) switch (vr[i]) {
      case VR_U: m->u = value[i]; break;
      case VR_AT: m->at = value[i]; break;
      case VR_GAIN: m->gain = value[i]; break;
      default: return ERROR;
    }
  return OK;
}
static int get_integer(Model *m, const uint32_t *vr, size_t n, int *value) {
  for (size_t i = 0; i < n; i++) value[i] = vr[i] == VR_COUNT ? m->count : m->mode;
  return OK;
}
static int set_integer(Model *m, const uint32_t *vr, size_t n, const int *value) {
  for (size_t i = 0; i < n; i++) {
    if (vr[i] != VR_MODE) return ERROR;
    m->mode = value[i];
  }
  return OK;
}

#if FMI_VERSION == 2

typedef struct {
  logger2 logger;
  void *(*allocate)(size_t, size_t);
  void (*release)(void *);
  void (*finished)(void *, int);
  void *environment;
} Callbacks;

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *c,
                      int visible, int logging) {
  (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
  return make(c->environment, (void (*)(void))c->logger);
}
void fmi2FreeInstance(void *m) { release(m); }
int fmi2SetupExperiment(void *m, int tolerance_defined, double tolerance, double start, int stop_defined, double stop) {
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  ((Model *)m)->t = start;
  return OK;
}
int fmi2EnterInitializationMode(void *m) { return (void)m, OK; }
int fmi2ExitInitializationMode(void *m) { return (void)m, OK; }
int fmi2Terminate(void *m) { return (void)m, OK; }
int fmi2GetReal(void *m, const uint32_t *vr, size_t n, double *v) { return get_real(m, vr, n, v); }
int fmi2SetReal(void *m, const uint32_t *vr, size_t n, const double *v) { return set_real(m, vr, n, v); }
int fmi2GetInteger(void *m, const uint32_t *vr, size_t n, int *v) { return get_integer(m, vr, n, v); }
int fmi2SetInteger(void *m, const uint32_t *vr, size_t n, const int *v) { return set_integer(m, vr, n, v); }
int fmi2DoStep(void *m, double t, double h, int no_set_state) {
  bool terminate = false;
  (void)no_set_state;
  return do_step(m, t, h, &terminate);
}

#else

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool event_mode, bool early_return, const uint32_t *intermediate,
                                  size_t count, void *environment, logger3 logger, void *update) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
  (void)intermediate, (void)count, (void)update;
  return make(environment, (void (*)(void))logger);
}
void fmi3FreeInstance(void *m) { release(m); }
int fmi3EnterInitializationMode(void *m, bool tolerance_defined, double tolerance, double start, bool stop_defined,
                                double stop) {
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  ((Model *)m)->t = start;
  return OK;
}
/* Event mode is in use: the FMU is in it after the initialisation. */
int fmi3ExitInitializationMode(void *m) { return ((Model *)m)->initialised = ((Model *)m)->in_event = true, OK; }
int fmi3EnterEventMode(void *m) { return ((Model *)m)->had_event = false, ((Model *)m)->in_event = true, OK; }
int fmi3EnterStepMode(void *m) { return ((Model *)m)->in_event = false, OK; }
/* Discrete inputs and tunable parameters change in event mode alone. */
static bool may_jump(const Model *m) { return !m->initialised || m->in_event; }
int fmi3Terminate(void *m) { return (void)m, OK; }
int fmi3UpdateDiscreteStates(void *m, bool *again, bool *terminate, bool *nominals, bool *states, bool *next_defined,
                             double *next) {
  (void)m, (void)next;
  *again = *terminate = *nominals = *states = *next_defined = false;
  return OK;
}
int fmi3EnterConfigurationMode(void *m) { return ((Model *)m)->configuring = true, OK; }
int fmi3ExitConfigurationMode(void *m) { return ((Model *)m)->configuring = false, OK; }
int fmi3SetUInt64(void *instance, const uint32_t *vr, size_t n, const uint64_t *v, size_t count) {
  Model *m = instance;
  if (!m->configuring || n != 1 || count != 1 || vr[0] != VR_N || v[0] > 8) return ERROR;
  m->n = v[0];
  return OK;
}
int fmi3GetFloat64(void *instance, const uint32_t *vr, size_t n, double *v, size_t count) {
  Model *m = instance;
  size_t at = 0;
  for (size_t i = 0; i < n; i++) {
    const size_t size = vr[i] == VR_W || vr[i] == VR_V ? m->n : 1;
    if (at + size > count) return ERROR;
    if (vr[i] == VR_W || vr[i] == VR_V)
      for (size_t k = 0; k < size; k++) v[at + k] = (vr[i] == VR_W ? 2 : 1) * m->v[k];
    else if (get_real(m, &vr[i], 1, &v[at]) != OK)
      return ERROR;
    at += size;
  }
  return at == count ? OK : ERROR;
}
int fmi3SetFloat64(void *instance, const uint32_t *vr, size_t n, const double *v, size_t count) {
  Model *m = instance;
  size_t at = 0;
  for (size_t i = 0; i < n; i++) {
    const size_t size = vr[i] == VR_V ? m->n : 1;
    if (at + size > count) return ERROR;
    if (vr[i] == VR_V)
      for (size_t k = 0; k < size; k++) m->v[k] = v[at + k];
    else if ((vr[i] == VR_GAIN && !may_jump(m)) || set_real(m, &vr[i], 1, &v[at]) != OK)
      return ERROR;
    at += size;
  }
  return at == count ? OK : ERROR;
}
int fmi3GetInt32(void *m, const uint32_t *vr, size_t n, int32_t *v, size_t count) {
  return n == count ? get_integer(m, vr, n, v) : ERROR;
}
int fmi3SetInt32(void *m, const uint32_t *vr, size_t n, const int32_t *v, size_t count) {
  return n == count ? set_integer(m, vr, n, v) : ERROR;
}
int fmi3GetBoolean(void *m, const uint32_t *vr, size_t n, bool *v, size_t count) {
  (void)vr;
  for (size_t i = 0; i < n && i < count; i++) v[i] = ((Model *)m)->on;
  return OK;
}
int fmi3SetBoolean(void *m, const uint32_t *vr, size_t n, const bool *v, size_t count) {
  (void)vr;
  if (!may_jump(m)) return ERROR;
  for (size_t i = 0; i < n && i < count; i++) ((Model *)m)->on = v[i];
  return OK;
}
int fmi3DoStep(void *instance, double t, double h, bool no_set_state, bool *event, bool *terminate, bool *early,
               double *reached) {
  Model *m = instance;
  (void)no_set_state;
  *event = *terminate = *early = false;
  if (m->in_event) return ERROR;
  if (m->had_event) return ERROR; /* which was not handled */
  if (m->mode == 11 && h > 0.006) {
    m->had_event = *event = *early = true;
    *reached = t + h / 2;
    return do_step(m, t, h / 2, terminate);
  }
  if (m->mode == 8) {
    *early = true;
    *reached = t;
    return OK;
  }
  *reached = t + h;
  return do_step(m, t, h, terminate);
}

#endif
