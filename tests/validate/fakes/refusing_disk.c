/* A disk that refuses, for processes that start with this library in LD_PRELOAD: once `refuse` has been called, requests that would change
   what lies below a folder are counted, and the request of one number, or all from it on, fail with an error number. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

static char below[4096];
static long asked, first, last;
static int refusal;

/* The requests number `from` to `to` (from 1) are refused. */
void refuse(const char *folder, long from, long to, int error) {
    snprintf(below, sizeof below, "%s", folder);
    first = from, last = to, refusal = error, asked = 0;
}

long requests(void) { return asked; }

static int refused(const char *path) {
    if (!below[0] || !path || strncmp(path, below, strlen(below)) != 0) return 0;
    asked++;
    if (asked < first || asked > last) return 0;
    errno = refusal;
    return 1;
}

static int refused_file(int file) {
    char link[64], path[4096];
    if (!below[0]) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return refused(path);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

ssize_t write(int file, const void *data, size_t size) { return refused_file(file) ? -1 : REAL(write)(file, data, size); }
ssize_t pwrite64(int file, const void *data, size_t size, off64_t at) {
    return refused_file(file) ? -1 : REAL(pwrite64)(file, data, size, at);
}
ssize_t sendfile64(int, int, off64_t *, size_t);
ssize_t sendfile64(int to, int from, off64_t *at, size_t size) { return refused_file(to) ? -1 : REAL(sendfile64)(to, from, at, size); }
ssize_t copy_file_range(int from, off64_t *at, int to, off64_t *there, size_t size, unsigned flags) {
    return refused_file(to) ? -1 : REAL(copy_file_range)(from, at, to, there, size, flags);
}
int fsync(int file) { return refused_file(file) ? -1 : REAL(fsync)(file); }
int mkdir(const char *path, mode_t mode) { return refused(path) ? -1 : REAL(mkdir)(path, mode); }
int rename(const char *from, const char *to) { return refused(to) ? -1 : REAL(rename)(from, to); }

int open64(const char *path, int flags, ...) {
    mode_t mode = 0;
    if (flags & O_CREAT) {
        va_list more;
        va_start(more, flags);
        mode = va_arg(more, mode_t);
        va_end(more);
        if (refused(path)) return -1;
    }
    return REAL(open64)(path, flags, mode);
}
