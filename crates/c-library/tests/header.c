/* The header in C11: its structs as C sees them, and every function called with nothing. */
#include <embree_trace/plant.h>
#include <stdio.h>
#include <string.h>

_Static_assert(sizeof(EtPlanted) == 40, "no gaps");
_Static_assert(sizeof(EtRecorded) == 56, "no gaps");

static int failures = 0;

static void check(int holds, const char* what) {
  if (holds) return;
  fprintf(stderr, "does not hold: %s: %s\n", what, et_error_message());
  failures++;
}

int main(void) {
  EtPlanted planted;
  EtRecorded recorded;
  int object = 0;
  RTCScene none = NULL;
  RTCScene odd = (RTCScene)(void*)&object;
  check(et_api_version() == ET_API_VERSION, "version");
  check(strchr(et_version(), '.') != NULL, "version");
  check(et_error_message()[0] == '\0', "no error yet");
  check(et_plant(none, "no.bvh", &planted) == ET_ERROR_FILE, "a file that is not there");
  check(strncmp(et_error_message(), "no.bvh: cannot be read: ", 24) == 0, "its name");
  check(et_plant(none, NULL, &planted) == ET_ERROR_ARGUMENT, "no path");
  check(strcmp(et_error_message(), "path is null") == 0, "no path");
  check(et_plant_memory(none, NULL, 0, NULL) == ET_ERROR_ARGUMENT, "no data");
  check(et_plant_memory(none, &object, sizeof object, NULL) == ET_ERROR_FILE, "no tree");
  check(et_unplant(none) == ET_ERROR_ARGUMENT, "no scene");
  check(et_unplant(odd) == ET_ERROR_ARGUMENT, "something that is no scene");
  check(et_unplant((RTCScene)(void*)((char*)&object + 1)) == ET_ERROR_ARGUMENT, "an odd address");
  check(et_unplant((RTCScene)(void*)8) == ET_ERROR_ARGUMENT, "an address where nothing is");
  check(et_record_begin(none, "a.rays", "a.bvh", 0) == ET_ERROR_ARGUMENT, "no scene");
  check(et_record_begin(odd, NULL, "a.bvh", 0) == ET_ERROR_ARGUMENT, "no path");
  check(et_record_begin(odd, "a.rays", NULL, 0) == ET_ERROR_ARGUMENT, "no path");
  check(et_record_begin(odd, "a.rays", "a.bvh", 2) == ET_ERROR_ARGUMENT, "an unknown flag");
  check(et_record_end(none, &recorded) == ET_ERROR_ARGUMENT, "no scene");
  check(et_record_end(odd, NULL) == ET_ERROR_ARGUMENT, "no scene");
  et_record_label(ET_NO_PATH, ET_NO_DEPTH, ET_PURPOSE_UNKNOWN);
  return failures == 0 ? 0 : 1;
}
