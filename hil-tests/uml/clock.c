/* A clock for user-mode-linux that a busy machine cannot upset, as `time-travel` is for kernels that were built with it.
 *
 * Preloaded, this stands between the guest's kernel and the host's clock and timer. The guest's time
 * - goes on with the processor time that the guest's kernel and the process that it runs have had, divided by
 *   GUEST_CLOCK_DIVISOR (a system call or a page fault costs tens of times more in the guest than on the machine itself),
 * - stands while the machine does something else or waits for its disk,
 * - jumps to the next timer when the guest has nothing to do.
 * Only CLOCK_MONOTONIC is the guest's; the calendar time that it reads once, when it starts, is the host's.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <time.h>

/* A running guest is made to look at the clock this often, and no look counts for more: whatever a virtual machine around
 * all this takes away counts as processor time. */
#define STRIDE_NS 200000
#define SECOND_NS 1000000000

static struct {
    int (*clock_gettime)(clockid_t, struct timespec *);
    int (*timer_settime)(timer_t, int, const struct itimerspec *, struct itimerspec *);
    int (*timer_create)(clockid_t, struct sigevent *, timer_t *);
    int (*sigaction)(int, const struct sigaction *, struct sigaction *);
    int (*sigsuspend)(const sigset_t *);
    pid_t (*waitpid)(pid_t, int *, int);
} host;

static int64_t divisor = 1;
static int64_t guest_ns;      /* the guest's time */
static int64_t kernel_ns;     /* processor time of the guest's kernel at the last look */
static pid_t running;         /* the process of the guest that its kernel waits for; 0 while it works itself */
static struct {
    pid_t pid;
    int64_t ns; /* its processor time at the last look */
} processes[256];
static int64_t expires_ns;    /* the guest's timer; 0 when it is off */
static int64_t interval_ns;
static timer_t alarm_timer;
static struct sigaction guest_alarm;
static volatile sig_atomic_t busy; /* the numbers above are being changed */

static int64_t to_ns(const struct timespec *time)
{
    return time->tv_sec * (int64_t)SECOND_NS + time->tv_nsec;
}

static struct timespec to_timespec(int64_t ns)
{
    return (struct timespec){.tv_sec = ns / SECOND_NS, .tv_nsec = ns % SECOND_NS};
}

__attribute__((constructor)) static void find_host(void)
{
    const char *text = getenv("GUEST_CLOCK_DIVISOR");

    *(void **)&host.clock_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    *(void **)&host.timer_settime = dlsym(RTLD_NEXT, "timer_settime");
    *(void **)&host.timer_create = dlsym(RTLD_NEXT, "timer_create");
    *(void **)&host.sigaction = dlsym(RTLD_NEXT, "sigaction");
    *(void **)&host.sigsuspend = dlsym(RTLD_NEXT, "sigsuspend");
    *(void **)&host.waitpid = dlsym(RTLD_NEXT, "waitpid");
    if (text && atoi(text) > 0)
        divisor = atoi(text);
}

static int64_t read_clock(clockid_t clock)
{
    struct timespec time;

    return host.clock_gettime(clock, &time) == 0 ? to_ns(&time) : 0;
}

/* Processor time that the running process has had since the last look. */
static int64_t process_passed_ns(void)
{
    size_t slot = (size_t)running % (sizeof processes / sizeof processes[0]);
    int64_t passed_ns = 0;
    int64_t now_ns;
    clockid_t clock;

    if (running <= 0 || clock_getcpuclockid(running, &clock) != 0)
        return 0;
    now_ns = read_clock(clock);
    if (processes[slot].pid == running && now_ns > processes[slot].ns)
        passed_ns = now_ns - processes[slot].ns;
    processes[slot].pid = running;
    processes[slot].ns = now_ns;
    return passed_ns;
}

/* Counts what has been done since the last look. */
static void look(void)
{
    int64_t now_ns, passed_ns;

    busy = 1;
    now_ns = read_clock(CLOCK_THREAD_CPUTIME_ID);
    passed_ns = now_ns - kernel_ns + process_passed_ns();
    kernel_ns = now_ns;
    guest_ns += (passed_ns < STRIDE_NS ? passed_ns : STRIDE_NS) / divisor;
    busy = 0;
}

/* Asks the host for a signal when the guest's timer may be due, and once in STRIDE_NS. */
static void set_alarm(void)
{
    int64_t left_ns = (expires_ns - guest_ns) * divisor;
    struct itimerspec alarm = {0};

    if (expires_ns) {
        if (left_ns > STRIDE_NS)
            left_ns = STRIDE_NS;
        alarm.it_value = to_timespec(left_ns > 0 ? left_ns : 1);
    }
    host.timer_settime(alarm_timer, 0, &alarm, NULL);
}

static void on_alarm(int number, siginfo_t *info, void *context)
{
    if (busy) {
        /* Interrupted in the middle of a look, which wants to go on: a little later. */
        struct itimerspec soon = {.it_value = {.tv_nsec = STRIDE_NS / 4}};

        host.timer_settime(alarm_timer, 0, &soon, NULL);
        return;
    }
    look();
    if (expires_ns == 0)
        return;
    if (guest_ns < expires_ns) {
        set_alarm();
        return;
    }
    expires_ns = interval_ns ? expires_ns + interval_ns : 0;
    if (expires_ns)
        set_alarm();
    guest_alarm.sa_sigaction(number, info, context);
}

int clock_gettime(clockid_t clock, struct timespec *time)
{
    if (clock != CLOCK_MONOTONIC)
        return host.clock_gettime(clock, time);
    look();
    *time = to_timespec(guest_ns);
    return 0;
}

int timer_create(clockid_t clock, struct sigevent *event, timer_t *timer)
{
    int result = host.timer_create(clock, event, timer);

    if (result == 0)
        alarm_timer = *timer;
    return result;
}

int timer_settime(timer_t timer, int flags, const struct itimerspec *wanted, struct itimerspec *before)
{
    (void)timer;
    (void)flags;
    (void)before;
    look();
    busy = 1;
    interval_ns = to_ns(&wanted->it_interval);
    expires_ns = to_ns(&wanted->it_value);
    if (expires_ns)
        expires_ns += guest_ns;
    busy = 0;
    set_alarm();
    return 0;
}

int timer_gettime(timer_t timer, struct itimerspec *left)
{
    int64_t left_ns = expires_ns - guest_ns;

    (void)timer;
    *left = (struct itimerspec){0};
    if (expires_ns)
        left->it_value = to_timespec(left_ns > 0 ? left_ns : 1);
    return 0;
}

/* The guest has nothing to do until its timer. It asks with SIGALRM blocked. */
int sigsuspend(const sigset_t *mask)
{
    if (expires_ns) {
        look();
        if (guest_ns < expires_ns)
            guest_ns = expires_ns;
        raise(SIGALRM);
    }
    return host.sigsuspend(mask);
}

int sigaction(int number, const struct sigaction *wanted, struct sigaction *before)
{
    struct sigaction ours;

    if (number != SIGALRM || !wanted || !(wanted->sa_flags & SA_SIGINFO))
        return host.sigaction(number, wanted, before);
    guest_alarm = *wanted;
    ours = *wanted;
    ours.sa_sigaction = on_alarm;
    return host.sigaction(number, &ours, before);
}

pid_t waitpid(pid_t pid, int *status, int options)
{
    pid_t result;

    running = pid;
    result = host.waitpid(pid, status, options);
    look();
    running = 0;
    return result;
}
