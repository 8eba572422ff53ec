/* The logger of FMI 2.0: a message and its arguments, as printf takes them, become one text for the instance that said it.
 *
 * An FMU may send a text that is no format, "5% short", and no arguments. C cannot count arguments, so each conversion is made here by itself:
 * a string is copied from readable memory alone, %n writes nothing, and a % that begins no conversion is a character like any other.
 */

#include <ctype.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
#define INSTANCES 64
#define ROOM 4096
#define PAGE 4096 /* of the smallest pages there are: memory is readable from one of its multiples to the next, or not at all */

typedef void (*Sink)(const char *);

static Sink sinks[INSTANCES];
static unsigned made;

/* Take a sink, the environment of a new instance; the oldest one leaves. */
EXPORT void logger_takes(void *sink) { sinks[made++ % INSTANCES] = (Sink)sink; }

/* A text that grows to ROOM. */
typedef struct {
    char at[ROOM];
    size_t length;
} Text;

static void add(Text *text, const char *more, size_t count)
{
    const size_t left = ROOM - 1 - text->length;
    if (count > left) count = left;
    memcpy(text->at + text->length, more, count);
    text->length += count;
}

/* Add a string of at most `most` bytes from memory that may be unreadable, which ends it: the kernel answers a write from there with an error. 0 if nothing could be read. */
static int add_string(Text *text, const char *string, size_t most)
{
    int ends[2], readable = 0;
    char chunk[PAGE];
    if (pipe(ends) != 0) return 0;
    while (most > 0) {
        size_t count = PAGE - (uintptr_t)string % PAGE;
        if (count > most) count = most;
        const ssize_t sent = write(ends[1], string, count);
        if (sent <= 0 || read(ends[0], chunk, (size_t)sent) != sent) break;
        readable = 1;
        const char *end = memchr(chunk, '\0', (size_t)sent);
        const size_t length = end ? (size_t)(end - chunk) : (size_t)sent;
        add(text, chunk, length);
        if (length < (size_t)sent || text->length == ROOM - 1) break;
        string += sent;
        most -= (size_t)sent;
    }
    close(ends[0]);
    close(ends[1]);
    return readable || most == 0;
}

/* Pad what was added behind `begin` to a width, on the left unless told. */
static void pad(Text *text, size_t begin, int width, int on_right)
{
    const size_t length = text->length - begin;
    if (width <= 0 || (size_t)width <= length) return;
    size_t blanks = (size_t)width - length;
    if (blanks > ROOM - 1 - text->length) blanks = ROOM - 1 - text->length;
    char *from = text->at + begin;
    if (!on_right) memmove(from + blanks, from, length);
    memset(on_right ? from + length : from, ' ', blanks);
    text->length += blanks;
}

/* One conversion: its text from % on, and what its letters say. */
typedef struct {
    char text[32];
    size_t length;
    int width, precision; /* -1: not given */
    int on_right;
    char size, letter; /* size: 0, h, H (hh), l, q (ll), j, z, t or L */
} Conversion;

/* A width or precision, at most ROOM either way: its argument may be any number. */
static int number(const char **at, va_list *arguments)
{
    long value;
    if (**at == '*') {
        (*at)++;
        value = va_arg(*arguments, int);
    } else {
        value = strtol(*at, (char **)at, 10);
    }
    return value > ROOM ? ROOM : value < -ROOM ? -ROOM : (int)value;
}

/* Read a conversion behind a %; 0 if there is none. */
static int conversion(const char *begin, Conversion *found, va_list *arguments)
{
    const char *at = begin + 1 + strspn(begin + 1, "-+ #0");
    const size_t flags = (size_t)(at - begin);
    const char *letter = at + strspn(at, "0123456789.*hljztqL");
    if (!*letter || !strchr("diouxXeEfFgGaAcspn", *letter) || flags > 8 || letter - at > 20) return 0;
    /* A blank is for signed numbers alone, so "5 % of it" is no conversion, and "5 % done" goes on as a word does. */
    if (memchr(begin, ' ', flags) && (!strchr("dieEfFgGaA", *letter) || isalpha((unsigned char)letter[1]))) return 0;
    found->on_right = memchr(begin, '-', flags) != NULL;
    found->width = strspn(at, "0123456789*") ? number(&at, arguments) : -1;
    if (found->width < -1) {
        found->on_right = 1;
        found->width = -found->width;
    }
    found->precision = -1;
    if (*at == '.') {
        at++;
        found->precision = strspn(at, "0123456789*") ? number(&at, arguments) : 0;
    }
    const size_t sizes = (size_t)(letter - at);
    if (strspn(at, "hljztqL") < sizes) return 0;
    found->size = sizes == 0 ? 0 : sizes == 1 ? *at : at[0] == 'h' ? 'H' : 'q';
    found->letter = *letter;
    /* The same with width and precision as numbers, for snprintf. */
    int length = snprintf(found->text, sizeof found->text, "%.*s", (int)flags, begin);
    if (found->on_right && !memchr(begin, '-', flags)) found->text[length++] = '-';
    if (found->width >= 0) length += snprintf(found->text + length, sizeof found->text - (size_t)length, "%d", found->width);
    if (found->precision >= 0) length += snprintf(found->text + length, sizeof found->text - (size_t)length, ".%d", found->precision);
    snprintf(found->text + length, sizeof found->text - (size_t)length, "%.*s", (int)sizes + 1, at);
    found->length = (size_t)(letter + 1 - begin);
    return 1;
}

/* Add what a conversion makes of its argument; 0 if that is no text that can be read. */
static int convert(Text *text, const Conversion *of, va_list *arguments)
{
#define PRINT(type) length = snprintf(piece, sizeof piece, of->text, va_arg(*arguments, type))
    char piece[ROOM];
    int length = 0;
    switch (of->letter) {
    case 's': {
        const char *string = va_arg(*arguments, const char *);
        const size_t begin = text->length;
        if (of->size || !add_string(text, string, of->precision < 0 ? ROOM : (size_t)of->precision)) return 0;
        pad(text, begin, of->width, of->on_right);
        return 1;
    }
    case 'n': (void)va_arg(*arguments, void *); return 0;
    case 'p': PRINT(void *); break;
    case 'c':
        if (of->size) {
            (void)va_arg(*arguments, int);
            return 0;
        }
        PRINT(int);
        break;
    case 'd': case 'i': case 'o': case 'u': case 'x': case 'X':
        switch (of->size) {
        case 'l': PRINT(long); break;
        case 'q': PRINT(long long); break;
        case 'j': PRINT(intmax_t); break;
        case 'z': PRINT(size_t); break;
        case 't': PRINT(ptrdiff_t); break;
        default: PRINT(int);
        }
        break;
    default:
        if (of->size == 'L') PRINT(long double);
        else PRINT(double);
    }
    if (length > 0) add(text, piece, (size_t)length < sizeof piece ? (size_t)length : sizeof piece - 1);
    return 1;
}

/* An environment that is no sink is a mistake of the FMU: its message goes to the newest one. */
EXPORT void logger_say(void *environment, const char *instance, int status, const char *category, const char *message, ...)
{
    Text text = {.length = 0};
    Conversion found;
    Sink sink = made ? sinks[(made - 1) % INSTANCES] : NULL;
    va_list arguments;
    (void)instance, (void)status, (void)category;
    for (unsigned place = 0; place < INSTANCES; place++)
        if (environment && environment == (void *)sinks[place]) sink = sinks[place];
    if (!message) message = "";
    va_start(arguments, message);
    while (*message && text.length < ROOM - 1) {
        size_t plain = strcspn(message, "%");
        if (plain == 0 && message[1] == '%') {
            add(&text, message, 1);
            message += 2;
            continue;
        }
        if (plain == 0 && conversion(message, &found, &arguments)) {
            if (!convert(&text, &found, &arguments)) add(&text, message, found.length);
            message += found.length;
            continue;
        }
        if (plain == 0) plain = 1;
        add(&text, message, plain);
        message += plain;
    }
    va_end(arguments);
    text.at[text.length] = '\0';
    if (sink) sink(text.at);
}
