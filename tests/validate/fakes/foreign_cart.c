/* Somebody else's FMU 2.0: a cart of 2 kg that meets an elastic stop at 500 mm, in millimetres and kilonewtons. Written for the tests.
 * With -DMISBEHAVE=n it goes wrong once time has passed 0.05 s; see foreign_fmu.py for the modes; with -DBEYOND=m only a cart of that mass does [kg]. With -DSAVES=1 it saves its state, with 2 it does
 * not restore it, with 3 it crashes there; -DWHOLE_STEPS makes one step of the midpoint rule a call; -DONCE lets a process have one instance; -DOWN_GRID=h makes steps
 * of h alone, whenever they are due, -DMULTIPLES_OF=h refuses calls that are no multiple of h. In Model Exchange -DLATCH=f holds the cart until an event finds it pushed by more [kN], and -DSAMPLED=h
 * lets it feel what it is pushed by at time events h apart. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <unistd.h>

#ifndef MISBEHAVE
#define MISBEHAVE 0
#endif
#ifndef BEYOND
#define BEYOND -1.0
#endif
#ifndef SAVES
#define SAVES 0
#endif

typedef struct {
    double time, pos, vel, force, mass, held;
    int touching, done, samples;
} Cart;

enum { POS = 10, VEL = 11, DPOS = 12, DVEL = 13, FORCE = 20, PUSH = 30, GAP = 31, MASS = 40 };
static const double STIFFNESS = 1000.0, STOP = 500.0;

static double gap(const Cart *c) { return STOP - c->pos; }
static double push(const Cart *c, int touching) { return touching ? -STIFFNESS * gap(c) / 1000.0 : 0.0; }
#if defined(LATCH)
static double drive(const Cart *c) { return c->held > 0.0 ? c->force : 0.0; }
#elif defined(SAMPLED)
static double drive(const Cart *c) { return c->held; }
#else
static double drive(const Cart *c) { return c->force; }
#endif
static double acceleration(const Cart *c, int touching) { return 1000.0 * (1000.0 * drive(c) - push(c, touching)) / c->mass; }

static const char MANY[1 << 20];
static int deeper(int n) { volatile char room[10000]; room[0] = (char)n; return deeper(n + 1) + room[0]; }
static void *forever(void *nothing) { for (;;) pause(); return nothing; }

static int misbehave(Cart *c)
{
    if (MISBEHAVE == 0 || c->time < 0.05 || c->mass < BEYOND || (c->done && MISBEHAVE != 9))
        return 0;
    c->done = 1;
    switch (MISBEHAVE) {
    case 1: for (;;) { }
    case 2: return *(volatile int *)0;
    case 3: exit(0);
    case 4: abort();
    case 5: c->vel = NAN; return 0;
    case 6: for (int i = 0; i < 20000; i++) printf("{\"ending\": \"OK\", \"value\": null}\n"); fflush(stdout); return 0;
    case 7: if (fork() == 0) { setsid(); for (;;) pause(); } return 0;
    case 8: for (;;) { char *p = malloc(1 << 26); memset(p, 1, 1 << 26); }
    case 9: return 4;
    case 10: chdir("/"); return 0;
    case 11: for (int i = 0; i < 64; i++) close(i); return 0;
    case 12: kill(getppid(), SIGKILL); return 0;
    case 13: kill(0, SIGKILL); return 0;
    case 14: return deeper(1);
    case 15: for (int i = 1; i < 32; i++) signal(i, SIG_IGN); return 0;
    case 16: clearenv(); return 0;
    case 17: fesetround(FE_UPWARD); return 0;
    case 18: feenableexcept(FE_DIVBYZERO | FE_INVALID); { volatile double zero = 0.0; zero = 1.0 / zero; } return 0;
    case 19: raise(SIGSTOP); return 0;
    case 20: { struct itimerval soon = {{0, 0}, {0, 1000}}; setitimer(ITIMER_REAL, &soon, NULL); for (;;) pause(); }
    case 21: if (fork() == 0) { setsid(); if (fork()) _exit(0); for (;;) pause(); } return 0;
    case 22: { FILE *file = fopen("filled", "w"); for (;;) if (fwrite(MANY, sizeof MANY, 1, file) != 1) abort(); }
    case 23: _exit(0);
    case 24: raise(SIGKILL); return 0;
    case 25: while (open("/dev/null", 0) >= 0) { } return 0;
    case 26: { FILE *file = fopen("left.txt", "w"); fclose(file); } return 0;
    case 27: { pthread_t id; pthread_create(&id, NULL, forever, NULL); return 0; }
    case 28: umask(0777); return 0;
    case 29: system("sleep 1000 &"); return 0;
    default: return 0;
    }
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const s[]) { (void)c; (void)on; (void)n; (void)s; return 0; }

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const void *f, int visible, int logging)
{
    Cart *c = calloc(1, sizeof(Cart));
    (void)name; (void)type; (void)guid; (void)where; (void)f; (void)visible; (void)logging;
    c->mass = 2.0;
#ifdef ONCE
    /* A static variable would begin anew with the library. */
    if (getenv("CART_WAS_HERE")) { free(c); return NULL; }
    setenv("CART_WAS_HERE", "1", 1);
#endif
    return c;
}
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int d, double tol, double start, int e, double stop) { (void)d; (void)tol; (void)e; (void)stop; ((Cart *)c)->time = start; return 0; }
int fmi2EnterInitializationMode(void *c) { (void)c; return 0; }
int fmi2ExitInitializationMode(void *c) { ((Cart *)c)->touching = gap(c) < 0; return 0; }
int fmi2Terminate(void *c) { (void)c; return 0; }
int fmi2Reset(void *c) { (void)c; return 3; }

int fmi2GetReal(void *p, const unsigned vr[], size_t n, double value[])
{
    Cart *c = p;
    for (size_t i = 0; i < n; i++)
        switch (vr[i]) {
        case POS: value[i] = c->pos; break;
        case VEL: case DPOS: value[i] = c->vel; break;
        case DVEL: value[i] = acceleration(c, c->touching); break;
        case FORCE: value[i] = c->force; break;
        case PUSH: value[i] = push(c, c->touching); break;
        case GAP: value[i] = gap(c); break;
        case MASS: value[i] = c->mass; break;
        default: return 3;
        }
    return 0;
}
int fmi2SetReal(void *p, const unsigned vr[], size_t n, const double value[])
{
    Cart *c = p;
    for (size_t i = 0; i < n; i++)
        switch (vr[i]) {
        case POS: c->pos = value[i]; break;
        case VEL: c->vel = value[i]; break;
        case FORCE: c->force = value[i]; break;
        case MASS: c->mass = value[i]; break;
        default: return 3;
        }
    return 0;
}

/* Model Exchange */
int fmi2EnterEventMode(void *c) { (void)c; return 0; }
int fmi2NewDiscreteStates(void *c, void *info)
{
    memset(info, 0, 32);
#if defined(LATCH)
    if (((Cart *)c)->force > LATCH) ((Cart *)c)->held = 1.0;
#elif defined(SAMPLED)
    struct { int flags[4], has_next; double next; } *said = info;
    Cart *own = c;
    if (own->time >= SAMPLED * own->samples) own->held = own->force, own->samples++;
    said->has_next = 1, said->next = SAMPLED * own->samples;
#endif
    ((Cart *)c)->touching = gap(c) < 0 || (gap(c) == 0 && ((Cart *)c)->vel > 0);
    /* At the event itself the gap is zero but for rounding: the direction of motion says which side follows. */
    if (fabs(gap(c)) < 1e-6)
        ((Cart *)c)->touching = ((Cart *)c)->vel > 0;
    return 0;
}
int fmi2EnterContinuousTimeMode(void *c) { (void)c; return 0; }
int fmi2CompletedIntegratorStep(void *c, int no, int *event, int *end) { (void)c; (void)no; *event = *end = 0; return 0; }
int fmi2SetTime(void *c, double time) { ((Cart *)c)->time = time; return 0; }
int fmi2SetContinuousStates(void *c, const double x[], size_t n) { (void)n; ((Cart *)c)->pos = x[0]; ((Cart *)c)->vel = x[1]; return 0; }
int fmi2GetContinuousStates(void *c, double x[], size_t n) { (void)n; x[0] = ((Cart *)c)->pos; x[1] = ((Cart *)c)->vel; return 0; }
int fmi2GetNominalsOfContinuousStates(void *c, double x[], size_t n) { (void)c; (void)n; x[0] = x[1] = 100.0; return 0; }
int fmi2GetDerivatives(void *c, double dx[], size_t n)
{
    int status = misbehave(c);
    (void)n;
    dx[0] = ((Cart *)c)->vel;
    dx[1] = acceleration(c, ((Cart *)c)->touching);
    return status;
}
#ifdef LATCH
int fmi2GetEventIndicators(void *c, double z[], size_t n) { (void)n; z[0] = LATCH - ((Cart *)c)->force; return 0; }
#else
int fmi2GetEventIndicators(void *c, double z[], size_t n) { (void)n; z[0] = gap(c); return 0; }
#endif

/* Co-Simulation: many small steps of the midpoint rule */
int fmi2DoStep(void *p, double time, double step, int no)
{
    Cart *c = p;
#if defined(WHOLE_STEPS)
    int count = 1;
#elif defined(MULTIPLES_OF)
    int count = (int)lround(step / MULTIPLES_OF);
    if (count < 1 || fabs(step - count * MULTIPLES_OF) > 1e-9 * step) return 3;
#elif defined(OWN_GRID)
    int count = (int)(lround((time + step) / OWN_GRID - 0.3) - lround(time / OWN_GRID - 0.3)); // 0.3: no end of a call is a tie
#else
    int count = (int)ceil(step / 2e-5 - 1e-9);
#endif
#ifdef OWN_GRID
    double h = OWN_GRID;
#else
    double h = step / count;
#endif
    (void)no;
    for (int i = 0; i < count; i++) {
        Cart m = *c;
        m.pos += h / 2 * c->vel;
        m.vel += h / 2 * acceleration(c, gap(c) < 0);
        c->pos += h * m.vel;
        c->vel += h * acceleration(&m, gap(&m) < 0);
    }
    c->touching = gap(c) < 0;
    c->time = time + step;
    return misbehave(c);
}

#if SAVES
int fmi2GetFMUstate(void *c, void **state)
{
    if (SAVES == 3) return *(volatile int *)0;
    if (!*state) *state = malloc(sizeof(Cart));
    *(Cart *)*state = *(Cart *)c;
    return 0;
}
int fmi2SetFMUstate(void *c, void *state) { if (SAVES == 1) *(Cart *)c = *(Cart *)state; return 0; }
int fmi2FreeFMUstate(void *c, void **state) { (void)c; free(*state); *state = NULL; return 0; }
#else
int fmi2GetFMUstate(void *c, void **state) { (void)c; (void)state; return 3; }
int fmi2SetFMUstate(void *c, void *state) { (void)c; (void)state; return 3; }
int fmi2FreeFMUstate(void *c, void **state) { (void)c; (void)state; return 3; }
#endif

/* Not offered */
#define REFUSED(name) int name(void) { return 3; }
REFUSED(fmi2GetInteger) REFUSED(fmi2SetInteger) REFUSED(fmi2GetBoolean) REFUSED(fmi2SetBoolean) REFUSED(fmi2GetString) REFUSED(fmi2SetString)
REFUSED(fmi2SerializedFMUstateSize) REFUSED(fmi2SerializeFMUstate)
REFUSED(fmi2DeSerializeFMUstate) REFUSED(fmi2GetDirectionalDerivative) REFUSED(fmi2SetRealInputDerivatives) REFUSED(fmi2GetRealOutputDerivatives)
REFUSED(fmi2CancelStep) REFUSED(fmi2GetStatus) REFUSED(fmi2GetRealStatus) REFUSED(fmi2GetIntegerStatus) REFUSED(fmi2GetBooleanStatus)
REFUSED(fmi2GetStringStatus)
