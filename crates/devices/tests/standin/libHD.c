/* A stand-in for OpenHaptics' libHD: two devices, each held by a simulated hand (mass, spring, damper), and a scheduler
 * thread at 1 kHz. Vendor names as in its public headers; what begins with standin_ lets tests make it fail.
 * In a process of its own environment variables do (script.h); with poses to follow both are Premiums. */
#define _GNU_SOURCE
#include <math.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include "script.h"

typedef struct { uint32_t code; int32_t internal; uint32_t device; } HDErrorInfo;
typedef uint32_t (*Callback)(void *);

#define N 2
#define INVALID 0xFFFFFFFFu

static struct Device {
    int open, plugged, hot, exceeded, fault, buttons, forces_on, ramping;
    uint32_t calibration;
    double target[3], position[3], velocity[3], force[3], torque[3];
} devices[N] = {{.plugged = 1, .calibration = 0x5000}, {.plugged = 1, .calibration = 0x5000}};
static const char *serials[N] = {"SN-1001", "SN-2002"};
static const char *models[N] = {"Phantom Omni", "Phantom Premium 1.5/6DOF"};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static HDErrorInfo queue[64];
static int queued, licence_bad, running, scheduled, calibrations;
static uint32_t current = INVALID;
static Callback callback;
static void *callback_data;
static pthread_t thread;

static void fail(uint32_t code, uint32_t device) {
    if (queued < 64) queue[queued++] = (HDErrorInfo){code, 0, device};
}
static int is_premium(uint32_t i) { return i == 1 || script_n[i]; }
static void play(void) {
    if (script_has_begun() && devices[0].open && devices[1].open && ++played == unplug_at) devices[1].plugged = 0;
    if (!devices[1].plugged && script_is_over()) devices[1].plugged = 1;
}
static struct Device *now(void) { return current < N && devices[current].open ? &devices[current] : NULL; }

uint32_t hdInitDevice(const char *name) {
    pthread_mutex_lock(&lock);
    uint32_t i = !name || !strcmp(name, "Default Device") ? 0 : !strcmp(name, "Phantom2") ? 1 : INVALID;
    if (licence_bad) { fail(0x600, INVALID); i = INVALID; }
    else if (i == INVALID || !devices[i].plugged) { fail(0x302, INVALID); i = INVALID; }
    else if (devices[i].open) { fail(0x301, i); i = INVALID; }
    else { devices[i].open = 1; devices[i].fault = 0; current = i; }
    pthread_mutex_unlock(&lock);
    return i;
}
void hdDisableDevice(uint32_t i) {
    pthread_mutex_lock(&lock);
    if (i < N) { devices[i].open = 0; memset(devices[i].force, 0, sizeof devices[i].force); }
    pthread_mutex_unlock(&lock);
}
void hdMakeCurrentDevice(uint32_t i) {
    current = i;
    if (!now()) fail(0x104, i);
}
void hdBeginFrame(uint32_t i) { if (i >= N || !devices[i].open) fail(0x104, i); }
void hdEndFrame(uint32_t i) {
    if (i >= N || !devices[i].open) { fail(0x104, i); return; }
    struct Device *d = &devices[i];
    if (!d->plugged) { fail(0x302, i); d->open = 0; memset(d->force, 0, sizeof d->force); }
    if (d->fault) fail(0x300, i);
    if (d->hot) fail(0x200, i);
    if (d->exceeded > 0) { d->exceeded--; fail(0x201, i); }
}
void hdEnable(uint32_t what) {
    struct Device *d = now();
    if (!d) { fail(0x104, current); return; }
    if (what == 0x4000) d->forces_on = 1;
    else if (what == 0x4002) d->ramping = 1;
    else if (what != 0x4001) fail(0x100, current);
}
void hdGetDoublev(uint32_t what, double *v) {
    struct Device *d = now();
    if (!d) { fail(0x104, current); return; }
    int premium = is_premium(current);
    switch (what) {
    case 0x2050: memcpy(v, d->position, sizeof d->position); break;
    case 0x2051: memcpy(v, d->velocity, sizeof d->velocity); break;
    case 0x2053: v[0] = v[1] = v[2] = 0; break;
    case 0x2052:
        if (scripted((int)current)) {
            memcpy(v, scripted((int)current), 16 * sizeof *v);
            break;
        }
        memset(v, 0, 16 * sizeof *v);
        v[0] = v[5] = v[10] = v[15] = 1;
        memcpy(v + 12, d->position, sizeof d->position);
        break;
    case 0x2551: v[0] = -80; v[1] = -60; v[2] = -35; v[3] = 80; v[4] = 60; v[5] = 35; break;
    case 0x2602: *v = premium ? 0.8 : 0.7; break;
    case 0x2603: *v = premium ? 8.5 : 3.3; break;
    case 0x2605: for (int k = 0; k < 6; k++) v[k] = d->hot ? 1.0 : 0.25; break;
    case 0x2622: *v = premium ? 188 : 0; break;
    default: fail(0x100, current);
    }
}
void hdGetIntegerv(uint32_t what, int32_t *v) {
    struct Device *d = now();
    if (!d) { fail(0x104, current); return; }
    switch (what) {
    case 0x2000: *v = d->buttons; break;
    case 0x2553: *v = 6; break;
    case 0x2554: *v = is_premium(current) ? 6 : 3; break;
    case 0x2555: *v = 4; break;
    default: fail(0x100, current);
    }
}
const char *hdGetString(uint32_t what) {
    if (!now()) { fail(0x104, current); return ""; }
    return what == 0x2504 ? serials[current] : what == 0x2501 ? models[is_premium(current)] : "";
}
void hdSetDoublev(uint32_t what, const double *v) {
    struct Device *d = now();
    if (!d) { fail(0x104, current); return; }
    if (what == 0x2700) memcpy(d->force, v, sizeof d->force);
    else if (what == 0x2701 && is_premium(current)) memcpy(d->torque, v, sizeof d->torque);
    else fail(0x100, current);
}
HDErrorInfo hdGetError(void) {
    HDErrorInfo e = {0, 0, INVALID};
    if (queued) { e = queue[0]; memmove(queue, queue + 1, --queued * sizeof *queue); }
    return e;
}
const char *hdGetErrorString(uint32_t code) { return code == 0x302 ? "HD_COMM_ERROR" : code == 0x600 ? "HD_INVALID_LICENSE" : "HD_ERROR"; }
uint32_t hdCheckCalibration(void) { struct Device *d = now(); return d ? d->calibration : 0x5002; }
void hdUpdateCalibration(uint32_t style) {
    struct Device *d = now();
    calibrations++;
    if (d && d->calibration == 0x5001 && style == 4) d->calibration = 0x5000;
}

static void *run(void *unused) {
    (void)unused;
    struct timespec t;
    setpriority(PRIO_PROCESS, (id_t)gettid(), -20); /* as the vendor's scheduler; without the right to it, as it is */
    clock_gettime(CLOCK_MONOTONIC, &t);
    while (__atomic_load_n(&running, __ATOMIC_ACQUIRE)) {
        t.tv_nsec += 1000000;
        if (t.tv_nsec >= 1000000000) { t.tv_nsec -= 1000000000; t.tv_sec++; }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        struct timespec late; /* Too late, it does not hurry: a hand would leap. */
        clock_gettime(CLOCK_MONOTONIC, &late);
        if ((late.tv_sec - t.tv_sec) * 1000000000 + late.tv_nsec - t.tv_nsec > 5000000) t = late;
        pthread_mutex_lock(&lock);
        if (scheduled) callback(callback_data);
        play();
        for (int i = 0; i < N; i++) { /* .1 kg, 500 N/m, 5 N s/m in mm */
            struct Device *d = &devices[i];
            for (int k = 0; k < 3; k++) {
                double f = (d->forces_on ? d->force[k] : 0) + 0.5 * (d->target[k] - d->position[k]) - 0.005 * d->velocity[k];
                d->velocity[k] += f / 0.1 * 1e3 * 1e-3;
                d->position[k] += d->velocity[k] * 1e-3;
            }
        }
        pthread_mutex_unlock(&lock);
    }
    return NULL;
}
void hdStartScheduler(void) {
    if (running) return;
    running = 1;
    pthread_create(&thread, NULL, run, NULL);
}
void hdStopScheduler(void) {
    if (!running) return;
    __atomic_store_n(&running, 0, __ATOMIC_RELEASE);
    pthread_join(thread, NULL);
    pthread_mutex_lock(&lock);
    for (int i = 0; i < N; i++) memset(devices[i].force, 0, sizeof devices[i].force);
    pthread_mutex_unlock(&lock);
}
unsigned long hdScheduleAsynchronous(Callback f, void *data, uint16_t priority) {
    pthread_mutex_lock(&lock);
    (void)priority;
    callback = f; callback_data = data; scheduled = 1;
    pthread_mutex_unlock(&lock);
    return 1;
}
void hdUnschedule(unsigned long handle) {
    pthread_mutex_lock(&lock);
    (void)handle;
    scheduled = 0;
    pthread_mutex_unlock(&lock);
}

#define LOCKED(...) do { pthread_mutex_lock(&lock); __VA_ARGS__; pthread_mutex_unlock(&lock); } while (0)
void standin_plug(int i, int on) { LOCKED(devices[i].plugged = on); }
void standin_overheat(int i, int on) { LOCKED(devices[i].hot = on); }
void standin_exceed(int i, int on) { LOCKED(devices[i].exceeded = on ? 1 : 0); }
void standin_defect(int i, int on) { LOCKED(devices[i].fault = on); }
void standin_calibration(int i, int state) { LOCKED(devices[i].calibration = 0x5000 + state); }
void standin_licence(int i, int good) { (void)i; LOCKED(licence_bad = !good); }
void standin_buttons(int i, int mask) { LOCKED(devices[i].buttons = mask); }
void standin_move(int i, double x, double y, double z) {
    LOCKED(devices[i].target[0] = x; devices[i].target[1] = y; devices[i].target[2] = z);
}
void standin_shown(int i, double *v) { /* force, torque */
    LOCKED(memcpy(v, devices[i].force, 24); memcpy(v + 3, devices[i].torque, 24));
}
void standin_place(int i, double *v) { LOCKED(memcpy(v, devices[i].position, 24)); }
