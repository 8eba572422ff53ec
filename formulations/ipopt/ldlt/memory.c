/* Memory taken together and released together. */

#include <stdlib.h>

#include "ldlt.h"

void *take(struct memory *memory, size_t number, size_t bytes)
{
    void *block = memory->count < (int)(sizeof memory->blocks / sizeof *memory->blocks) ? calloc(number + 1, bytes) : NULL;
    if (block)
        memory->blocks[memory->count++] = block;
    else
        memory->failed = 1;
    return block;
}

void release(struct memory *memory)
{
    while (memory->count > 0)
        free(memory->blocks[--memory->count]);
}
