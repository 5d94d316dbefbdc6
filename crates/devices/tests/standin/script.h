/* Scripts for the stand-ins, by environment variables: STANDIN_POSES_0 and _1 name files of transforms (16 doubles each,
 * column-major, in mm and the vendor's frame) that the hands follow, one a tick, once the file STANDIN_GO is there;
 * STANDIN_UNPLUG=TICK:TICKS unplugs the second device at that tick for so long. The hands wait meanwhile. */
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

static double *script[2];
static int script_n[2], played, unplug_at = -1, unplug_for;
static const char *go;

static void read_script(int i) {
    char name[] = "STANDIN_POSES_0";
    name[14] = (char)('0' + i);
    FILE *file = getenv(name) ? fopen(getenv(name), "rb") : NULL;
    if (!file) return;
    fseek(file, 0, SEEK_END);
    size_t n = (size_t)ftell(file) / (16 * sizeof(double));
    rewind(file);
    script[i] = malloc(n * 16 * sizeof(double));
    if (fread(script[i], 16 * sizeof(double), n, file) == n) script_n[i] = (int)n;
    fclose(file);
}
__attribute__((constructor)) static void read_scripts(void) {
    go = getenv("STANDIN_GO");
    for (int i = 0; i < 2; i++) read_script(i);
    if (getenv("STANDIN_UNPLUG")) sscanf(getenv("STANDIN_UNPLUG"), "%d:%d", &unplug_at, &unplug_for);
}
static int script_has_begun(void) {
    static int has_begun, ticks;
    return has_begun |= go && ticks++ % 32 == 0 && access(go, F_OK) == 0;
}
static int script_is_over(void) { return unplug_for > 0 && --unplug_for == 0; }
/* The pose to take now, or NULL without a script. */
static const double *scripted(int i) {
    return script_n[i] ? script[i] + 16 * (played < script_n[i] ? played : script_n[i] - 1) : NULL;
}
