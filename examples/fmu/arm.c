/* A servo drive with an arm, as an FMU of FMI 3.0 for co-simulation: the smallest that a rig can use.
 *
 *   torque = limited(stiffness (target - angle) - damping rate)      rate' = torque / inertia      angle' = rate
 *
 * integrated by semi-implicit Euler in steps of 1 ms. The functions are those of the FMI Standard 3.0.2
 * (fmi3Functions.h); types are written out, so that this file needs no header of it. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

enum { OK, WARNING, DISCARD, ERROR };
enum { TIME, TARGET, ANGLE, RATE, INERTIA, MAX_TORQUE };

typedef struct {
  double value[6];
} Arm;

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool event_mode, bool early_return, const uint32_t *intermediate,
                                  size_t intermediate_count, void *environment, void *log, void *update) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
  (void)intermediate, (void)intermediate_count, (void)environment, (void)log, (void)update;
  Arm *arm = calloc(1, sizeof *arm);
  if (!arm) return NULL;
  arm->value[INERTIA] = 0.2;
  arm->value[MAX_TORQUE] = 4;
  return arm;
}
void fmi3FreeInstance(void *instance) { free(instance); }
int fmi3EnterInitializationMode(void *instance, bool tolerance_defined, double tolerance, double start,
                                bool stop_defined, double stop) {
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  ((Arm *)instance)->value[TIME] = start;
  return OK;
}
int fmi3ExitInitializationMode(void *instance) { return (void)instance, OK; }
int fmi3Terminate(void *instance) { return (void)instance, OK; }

int fmi3GetFloat64(void *instance, const uint32_t *variables, size_t count, double *values, size_t value_count) {
  if (count != value_count) return ERROR;
  for (size_t i = 0; i < count; i++) {
    if (variables[i] > MAX_TORQUE) return ERROR;
    values[i] = ((Arm *)instance)->value[variables[i]];
  }
  return OK;
}
int fmi3SetFloat64(void *instance, const uint32_t *variables, size_t count, const double *values, size_t value_count) {
  if (count != value_count) return ERROR;
  for (size_t i = 0; i < count; i++) {
    if (variables[i] == TIME || variables[i] > MAX_TORQUE) return ERROR;
    ((Arm *)instance)->value[variables[i]] = values[i];
  }
  return OK;
}

int fmi3DoStep(void *instance, double t, double step, bool no_set_state, bool *event, bool *terminate, bool *early,
               double *reached) {
  double *v = ((Arm *)instance)->value;
  const int steps = (int)(step * 1000 + 0.5) > 0 ? (int)(step * 1000 + 0.5) : 1;
  const double h = step / steps;
  (void)no_set_state;
  for (int i = 0; i < steps; i++) {
    double torque = 40 * (v[TARGET] - v[ANGLE]) - 5 * v[RATE];
    if (torque > v[MAX_TORQUE]) torque = v[MAX_TORQUE];
    if (torque < -v[MAX_TORQUE]) torque = -v[MAX_TORQUE];
    v[RATE] += h * torque / v[INERTIA];
    v[ANGLE] += h * v[RATE];
  }
  v[TIME] = *reached = t + step;
  *event = *terminate = *early = false;
  return OK;
}
