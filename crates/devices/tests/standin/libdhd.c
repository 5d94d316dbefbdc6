/* A stand-in for Force Dimension's libdhd: a sigma.7 and an omega.3, each held by a simulated hand that moves on with every
 * reading. Vendor names as in its public headers; what begins with standin_ lets tests make it fail.
 * In a process of its own the same environment variables do as for libHD.c; a tick is a reading of the first device, and
 * with poses to follow both are sigma.7. */
#define _GNU_SOURCE
#include <pthread.h>
#include <stdbool.h>
#include <string.h>
#include "script.h"

#define N 2
static struct Device {
    int open, plugged, broken, reset, enabled;
    unsigned buttons;
    double target[3], position[3], velocity[3], force[3], torque[3];
} devices[N] = {{.plugged = 1, .reset = 1}, {.plugged = 1, .reset = 1}};
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static __thread const char *error = "no error";
static int present = N;

static void play(void) {
    if (script_has_begun() && devices[0].open && devices[1].open && devices[1].plugged && ++played == unplug_at)
        devices[1].plugged = 0;
    if (!devices[1].plugged && script_is_over()) devices[1].plugged = 1;
}
static bool is_sigma(char id) { return id == 0 || script_n[1]; }

static struct Device *get(char id) {
    if (id < 0 || id >= N || !devices[(int)id].open || !devices[(int)id].plugged) { error = "device not available"; return NULL; }
    return &devices[(int)id];
}
#define LOCKED(...) do { pthread_mutex_lock(&lock); __VA_ARGS__; pthread_mutex_unlock(&lock); } while (0)

int dhdGetDeviceCount(void) { return present; }
int dhdOpenID(char id) {
    int result = -1;
    LOCKED(if (id >= 0 && id < N && devices[(int)id].plugged && !devices[(int)id].open) {
        devices[(int)id].open = 1; result = id;
    } else error = "device not available");
    return result;
}
int dhdClose(char id) {
    LOCKED(if (id >= 0 && id < N) { struct Device *d = &devices[(int)id]; d->open = d->enabled = 0; memset(d->force, 0, 24); });
    return 0;
}
int dhdGetSerialNumber(unsigned short *sn, char id) { *sn = id == 0 ? 7001 : 3002; return id >= 0 && id < N ? 0 : -1; }
const char *dhdGetSystemName(char id) { return is_sigma(id) ? "sigma.7" : "omega.3"; }
bool dhdHasWrist(char id) { return is_sigma(id); }
bool dhdHasActiveWrist(char id) { return is_sigma(id); }
int dhdEnableForce(unsigned char on, char id) {
    int result = -1;
    LOCKED(struct Device *d = get(id); if (d) { d->enabled = on; result = 0; });
    return result;
}
int dhdSetTimeGuard(int us, char id) { (void)us; (void)id; return 0; }
int dhdGetPositionAndOrientationFrame(double *x, double *y, double *z, double m[3][3], char id) {
    int result = -1;
    LOCKED(if (id == 0) play(); struct Device *d = get(id); const double *pose = d ? scripted(id) : NULL; if (pose) {
        for (int k = 0; k < 3; k++) d->position[k] = pose[12 + k] * 1e-3;
        for (int k = 0; k < 9; k++) m[k / 3][k % 3] = pose[k % 3 * 4 + k / 3];
        *x = d->position[0]; *y = d->position[1]; *z = d->position[2];
        result = 0;
    } else if (d) {
        for (int k = 0; k < 3; k++) { /* 1 ms; .1 kg, 500 N/m, 5 N s/m */
            double f = (d->enabled ? d->force[k] : 0) + 500 * (d->target[k] - d->position[k]) - 5 * d->velocity[k];
            d->velocity[k] += f / 0.1 * 1e-3;
            d->position[k] += d->velocity[k] * 1e-3;
        }
        *x = d->position[0]; *y = d->position[1]; *z = d->position[2];
        memset(m, 0, 9 * sizeof(double));
        m[0][0] = m[1][1] = m[2][2] = 1;
        result = 0;
    });
    return result;
}
int dhdGetLinearVelocity(double *x, double *y, double *z, char id) {
    int result = -1;
    LOCKED(struct Device *d = get(id); if (d) { *x = d->velocity[0]; *y = d->velocity[1]; *z = d->velocity[2]; result = 0; });
    return result;
}
int dhdGetAngularVelocityRad(double *x, double *y, double *z, char id) {
    int result = -1;
    LOCKED(if (get(id)) { *x = *y = *z = 0; result = 0; });
    return result;
}
int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty, double tz, double g, char id) {
    int result = -1;
    (void)g;
    LOCKED(struct Device *d = get(id); if (d) {
        double f[3] = {fx, fy, fz}, t[3] = {tx, ty, tz};
        memcpy(d->force, f, 24);
        memcpy(d->torque, t, 24);
        result = fx * fx + fy * fy + fz * fz > 144 ? 2 : 0; /* 2: motors saturated */
    });
    return result;
}
unsigned dhdGetButtonMask(char id) { return id >= 0 && id < N ? devices[(int)id].buttons : 0; }
int dhdGetStatus(int *status, char id) {
    int result = -1;
    LOCKED(struct Device *d = get(id); if (d) {
        memset(status, 0, 17 * sizeof(int));
        status[0] = status[1] = status[2] = 1;
        status[3] = d->reset;
        status[9] = d->broken;
        result = 0;
    });
    return result;
}
const char *dhdErrorGetLastStr(void) { return error; }

void standin_plug(int i, int on) { LOCKED(devices[i].plugged = on; if (!on) memset(devices[i].force, 0, 24)); }
void standin_calibration(int i, int state) { LOCKED(devices[i].reset = state == 0); }
void standin_defect(int i, int on) { LOCKED(devices[i].broken = on); }
void standin_present(int i, int n) { (void)i; LOCKED(present = n); }
void standin_buttons(int i, int mask) { LOCKED(devices[i].buttons = mask); }
void standin_move(int i, double x, double y, double z) { /* mm, in the vendor's frame, like libHD's */
    LOCKED(devices[i].target[0] = x * 1e-3; devices[i].target[1] = y * 1e-3; devices[i].target[2] = z * 1e-3);
}
void standin_shown(int i, double *v) { LOCKED(memcpy(v, devices[i].force, 24); memcpy(v + 3, devices[i].torque, 24)); }
