/* What code of somebody else may do to the process it is called in. Written for the tests. */
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

static volatile int sink;
static jmp_buf nowhere;
static int crash_at_unload;

static int dig(int n) { volatile char frame[4096]; frame[0] = (char)n; sink += frame[0]; return dig(n + 1) + frame[0]; }
static void *leave(void *nothing) { (void)nothing; exit(0); }
static void ignore(int number) { (void)number; }
__attribute__((destructor)) static void unload(void) { if (crash_at_unload) *(volatile int *)0 = 1; }

void one_huge_allocation(void) { memset(malloc((size_t)1 << 44), 1, 4096); }
void null_pointer(void) { *(volatile int *)0 = 1; }
void endless_recursion(void) { dig(0); }
void exit_in_a_thread(void) { pthread_t t; pthread_create(&t, NULL, leave, NULL); pthread_join(t, NULL); }
void change_folder(void) { if (chdir("/")) abort(); }
void close_files(void) { for (int n = 0; n < 3; n++) close(n); }
void ignore_signals(void)
{
    sigset_t all;
    for (int n = 1; n < 32; n++) signal(n, ignore);
    sigfillset(&all);
    sigprocmask(SIG_BLOCK, &all, NULL);
    for (;;) pause();
}
/* A daemon that left the session and the environment; what follows gives it the time to. */
void start_daemon(void)
{
    char seconds[24], *const arguments[] = {"sleep", seconds, NULL}, *const nothing[] = {NULL};
    snprintf(seconds, sizeof seconds, "%d", SLEEP);
    if (fork() == 0) {
        setsid();
        if (fork() == 0) execve("/bin/sleep", arguments, nothing);
        _exit(0);
    }
    usleep(500000);
}
void start_daemon_and_crash(void) { start_daemon(); null_pointer(); }
void remove_what_is_there(void) { if (system("rm -rf ../* ../.[a-z]*")) abort(); }
void take_all_limits(void) { const struct rlimit none = {0, 0}; setrlimit(RLIMIT_NOFILE, &none); }
void jump_out(void) { longjmp(nowhere, 1); }
void break_the_heap(void) { char *volatile p = malloc(16); free(p); free(p); }
void crash_when_unloaded(void) { crash_at_unload = 1; }
void stop_the_group(void) { kill(0, SIGTERM); }
