/* Speaks tfbus's wire in C99 alone: reads and writes messages of transforms, and descriptions.
 *
 *     cc -std=c99 -O2 -o tfbus_wire examples/wire/tfbus_wire.c -lm
 *     python examples/wire/shuttle.py ./tfbus_wire listen
 *     python examples/wire/shuttle.py ./tfbus_wire talk NAME
 *
 * `listen` prints what all streams of the bus send, `talk` publishes a dynamic and a static frame.
 * Zenoh itself is not in here: shuttle.py carries keys and bytes between the bus and this program,
 * one line each. In a program of your own, zenoh-c or zenoh-pico takes its place. Each comment names
 * the section of docs/reference/wire.md that the lines below it follow.
 *
 *     from the bus: session ID HOST PID | now NS | alive KEY | lost KEY | message HEX KEY
 *     to the bus:   token KEY | put HEX KEY | retain HEX KEY | answer HEX KEY
 */

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* How large messages may be */
enum { MOST_BYTES = 16000000, MOST_VALUES = 1000000, MOST_LETTERS = 255, MOST_STREAMS = 1000 };
enum { MOST_ROWS = 300000 }; /* Frames by numbers */

typedef unsigned char Byte;

static void *room_for(void *data, size_t size) {
    data = realloc(data, size ? size : 1);
    if (data == NULL) {
        fprintf(stderr, "tfbus_wire: no memory for %zu bytes\n", size);
        exit(1);
    }
    return data;
}

/* --------------------------------------------------------------------- Reading MessagePack */

typedef enum { NIL, BOOLEAN, INTEGER, FLOAT, TEXT, BINARY, ARRAY, MAP, EXTENSION } Kind;

typedef struct {
    Kind kind;
    int64_t integer;  /* of an integer or boolean */
    double number;    /* of a float or integer */
    uint32_t size;    /* bytes of a text or binary, items of an array, pairs of a map */
    const Byte *data; /* of a text or binary */
} Item;

typedef struct {
    const Byte *at, *end;
    int values;         /* read so far */
    char error[160];
} Reader;

static int fail(Reader *reader, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(reader->error, sizeof reader->error, format, arguments);
    va_end(arguments);
    return 0;
}

static uint64_t big_endian(const Byte *bytes, int count) {
    uint64_t number = 0;
    for (int i = 0; i < count; i++) number = number << 8 | bytes[i];
    return number;
}

static uint64_t little_endian(const Byte *bytes, int count) {
    uint64_t number = 0;
    for (int i = count; i-- > 0;) number = number << 8 | bytes[i];
    return number;
}

static double as_double(uint64_t bits) {
    double number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

static int64_t as_signed(uint64_t bits) {
    int64_t number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

/* The next code point of UTF-8, or -1 where the bytes are none. */
static int32_t next_letter(const Byte **at, const Byte *end) {
    static const int32_t least[] = {0, 0x80, 0x800, 0x10000};
    int32_t first = *(*at)++;
    int more = first < 0x80 ? 0 : first < 0xC0 ? -1 : first < 0xE0 ? 1 : first < 0xF0 ? 2 : 3;
    if (more == 0) return first;
    if (more < 0 || first > 0xF4 || end - *at < more) return -1;
    int32_t letter = first & (0x3F >> more);
    for (int i = 0; i < more; i++) {
        if ((**at & 0xC0) != 0x80) return -1;
        letter = letter << 6 | (*(*at)++ & 0x3F);
    }
    if (letter < least[more] || letter > 0x10FFFF || (letter >= 0xD800 && letter < 0xE000))
        return -1;
    return letter;
}

static int is_utf8(const Byte *at, uint32_t size) {
    const Byte *end = at + size;
    while (at < end)
        if (next_letter(&at, end) < 0) return 0;
    return 1;
}

/* Read one value; of an array or map only its head: its items are the next values. */
static int next(Reader *reader, Item *item) {
    if (reader->at == reader->end) return fail(reader, "it ends too early");
    if (++reader->values > MOST_VALUES)
        return fail(reader, "it holds more than %d values", MOST_VALUES);
    Byte tag = *reader->at++;
    size_t left = (size_t)(reader->end - reader->at);
    int width = 0; /* of the number or size that follows the tag */
    memset(item, 0, sizeof *item);
    if (tag < 0x80 || tag >= 0xE0) {
        item->kind = INTEGER;
        item->integer = tag < 0x80 ? tag : (int)tag - 256;
        item->number = (double)item->integer;
        return 1;
    }
    if (tag < 0xC0) {
        item->kind = tag < 0x90 ? MAP : tag < 0xA0 ? ARRAY : TEXT;
        item->size = tag & (tag < 0xA0 ? 0x0F : 0x1F);
    } else {
        /* c0 nil, c1 none, c2-3 boolean, c4-6 binary, c7-9 extension, ca-b float, cc-f unsigned,
           d0-3 signed, d4-8 extension of a fixed size, d9-b text, dc-d array, de-f map */
        static const Byte kinds[] = {
            NIL, 0xFF, BOOLEAN, BOOLEAN, BINARY, BINARY, BINARY, EXTENSION, EXTENSION, EXTENSION,
            FLOAT, FLOAT, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER,
            EXTENSION, EXTENSION, EXTENSION, EXTENSION, EXTENSION, TEXT, TEXT, TEXT, ARRAY, ARRAY,
            MAP, MAP};
        static const Byte widths[] = {0, 0, 0, 0, 1, 2, 4, 1, 2, 4, 4, 8, 1, 2, 4, 8,
                                      1, 2, 4, 8, 0, 0, 0, 0, 0, 1, 2, 4, 2, 4, 2, 4};
        if (tag == 0xC1) return fail(reader, "the byte c1 is not MessagePack");
        item->kind = (Kind)kinds[tag - 0xC0];
        width = widths[tag - 0xC0];
        if ((size_t)width > left) return fail(reader, "it ends too early");
        uint64_t number = big_endian(reader->at, width);
        reader->at += width;
        left -= (size_t)width;
        if (item->kind == BOOLEAN) {
            item->integer = tag == 0xC3;
        } else if (item->kind == FLOAT && width == 4) {
            uint32_t bits = (uint32_t)number;
            float narrow;
            memcpy(&narrow, &bits, sizeof narrow);
            item->number = narrow;
        } else if (item->kind == FLOAT) {
            item->number = as_double(number);
        } else if (item->kind == INTEGER && tag < 0xD0) {
            /* Beyond a signed 64-bit integer it is no time, index or count. */
            if (number > INT64_MAX) item->kind = FLOAT;
            item->integer = number > INT64_MAX ? 0 : (int64_t)number;
            item->number = (double)number;
        } else if (item->kind == INTEGER) {
            uint64_t sign = (uint64_t)1 << (8 * width - 1);
            item->integer = as_signed((number ^ sign) - sign);
            item->number = (double)item->integer;
        } else if (tag >= 0xD4 && tag <= 0xD8) {
            item->size = 1u << (tag - 0xD4);
        } else {
            item->size = (uint32_t)number;
        }
    }
    if (item->kind == EXTENSION && left-- == 0) return fail(reader, "it ends too early");
    if (item->kind == EXTENSION) reader->at++; /* its type */
    /* Each item of an array or map has a byte at least. */
    if (item->size > left) return fail(reader, "it ends too early");
    if (item->kind == TEXT || item->kind == BINARY || item->kind == EXTENSION) {
        item->data = reader->at;
        reader->at += item->size;
    }
    if (item->kind == TEXT && !is_utf8(item->data, item->size))
        return fail(reader, "a text is not UTF-8");
    return 1;
}

/* Skip what an array or map holds, however deep; without recursion, so the stack cannot overflow. */
static int skip_within(Reader *reader, const Item *item) {
    Item inner = *item;
    uint64_t open = 1; /* values that are still to be read, the current one included */
    for (;;) {
        if (inner.kind == ARRAY) open += inner.size;
        if (inner.kind == MAP) open += 2 * (uint64_t)inner.size;
        if (--open == 0) return 1;
        if (!next(reader, &inner)) return 0;
    }
}

static int is_text(const Item *item, const char *text) {
    return item->kind == TEXT && item->size == strlen(text) &&
           memcmp(item->data, text, item->size) == 0;
}

/* Whether an integer stands for a float, or for a boolean (Topics). */
static int stands_for(const Item *item, Kind kind) {
    return item->kind == INTEGER &&
           (kind == FLOAT || (kind == BOOLEAN && (item->integer == 0 || item->integer == 1)));
}

/* A key that this program knows, and the type that its value must have. */
typedef struct {
    const char *name;
    Kind kind;
    int needed;
    Kind other;  /* another type that it may have; nil for none */
    Item item;   /* nil where it is missing */
    Reader rest; /* where the items of an array begin */
} Field;

/* Read one map with all these fields, and nothing behind it (What to ignore and what to refuse). The
   first field is its version, which may be the newest that is known of such maps, or before. */
static int read_map(Reader *reader, Field *fields, int count, int newest) {
    Item map, key, value;
    if (reader->end - reader->at > MOST_BYTES)
        return fail(reader, "it has more than %d bytes", MOST_BYTES);
    if (!next(reader, &map)) return 0;
    if (map.kind != MAP) return fail(reader, "it is not a map");
    for (uint32_t pair = 0; pair < map.size; pair++) {
        if (!next(reader, &key)) return 0;
        if (key.kind != TEXT) return fail(reader, "a key of the map is not a text");
        if (!next(reader, &value)) return 0;
        for (int i = 0; i < count; i++)
            if (is_text(&key, fields[i].name)) {
                fields[i].item = value;
                fields[i].rest = *reader;
            }
        if (!skip_within(reader, &value)) return 0;
    }
    if (reader->at != reader->end) return fail(reader, "bytes follow the map");
    for (int i = 0; i < count; i++) {
        Field *field = &fields[i];
        int has_type = field->item.kind == field->kind || stands_for(&field->item, field->kind) ||
                       (field->other != NIL && field->item.kind == field->other);
        if (field->rest.at == NULL ? field->needed : !has_type)
            return fail(reader, "'%s' is missing or of another type", field->name);
        if (i == 0 && (field->item.integer < 1 || field->item.integer > newest))
            return fail(reader, "it is of version %" PRId64 ", and this program reads %s",
                        field->item.integer, newest == 1 ? "1" : "1 and 2");
    }
    return 1;
}

/* ---------------------------------------------------------------------------- Names in keys */

/* Whether a letter can be printed; a space can, other white space cannot. Code points that Unicode
   has not assigned are let through: they differ from one version of it to the next. */
static int is_printable(int32_t letter) {
    static const int32_t ranges[][2] = {
        {0x0, 0x1F}, {0x7F, 0xA0}, {0xAD, 0xAD}, {0x600, 0x605}, {0x61C, 0x61C}, {0x6DD, 0x6DD},
        {0x70F, 0x70F}, {0x890, 0x891}, {0x8E2, 0x8E2}, {0x1680, 0x1680}, {0x180E, 0x180E},
        {0x2000, 0x200F}, {0x2028, 0x202F}, {0x205F, 0x206F}, {0x3000, 0x3000}, {0xD800, 0xF8FF},
        {0xFEFF, 0xFEFF}, {0xFFF0, 0xFFFB}, {0xFFFE, 0xFFFF}, {0x110BD, 0x110BD},
        {0x110CD, 0x110CD}, {0x13430, 0x1343F}, {0x1BCA0, 0x1BCA3}, {0x1D173, 0x1D17A},
        {0xE0000, 0xE00FF}, {0xE01F0, 0x10FFFF}};
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++)
        if (letter >= ranges[i][0] && letter <= ranges[i][1]) return 0;
    return 1;
}

static int is_name(const Item *name) {
    const Byte *at = name->data;
    int letters = 0;
    for (uint32_t left = name->size; left > 0; left = name->size - (uint32_t)(at - name->data))
        if (!is_printable(next_letter(&at, at + left)) || ++letters > MOST_LETTERS) return 0;
    return 1;
}

static int is_frame_name(const Item *name) {
    return name->size > 0 && name->data[0] != '/' && is_name(name);
}

/* The stream of a key that begins so, with at most this many chunks behind that, or NULL. The name
   is left as it is in the key, percent-escaped. */
static const char *stream_of(const char *key, const char *root, int most, size_t *size) {
    size_t root_size = strlen(root);
    if (strncmp(key, root, root_size) != 0) return NULL;
    key += root_size;
    int chunks = 1;
    for (const char *at = key; *at; at++) chunks += *at == '/';
    *size = strcspn(key, "/");
    if (chunks > most || *size == 0) return NULL;
    for (const char *at = key; at + 8 <= key + *size; at++)
        if (strncmp(at, "::dds_::", 8) == 0) return NULL; /* Beside ROS 2 */
    return key;
}

/* ------------------------------------------------------------------------------------ Streams */

/* A frame by its number, and the pose that others of it count from (Frames by numbers). */
typedef struct {
    int64_t number;
    Item parent, child; /* in the description */
    double origin[7];
} Numbered;

/* The numbers in a stream's description, in their order. */
typedef struct {
    Byte *description;
    Numbered *rows;
    uint32_t count;
    int64_t epoch, next_number;
} Numbers;

static void forget_numbers(Numbers *numbers) {
    free(numbers->description);
    free(numbers->rows);
    memset(numbers, 0, sizeof *numbers);
}

static int by_number(const void *one, const void *other) {
    int64_t left = ((const Numbered *)one)->number, right = ((const Numbered *)other)->number;
    return left < right ? -1 : left > right;
}

/* The row of a number, or NULL. */
static const Numbered *find_number(const Numbers *numbers, int64_t number) {
    Numbered wanted = {.number = number};
    if (numbers->count == 0) return NULL;
    return bsearch(&wanted, numbers->rows, numbers->count, sizeof wanted, by_number);
}

/* Epochs, in short: the larger counts, and any after a lost token. listen.py has the whole rule. */
typedef struct {
    char *name;
    int64_t epoch;
    int is_known;
    Numbers numbers;
} Stream;

static Stream streams[MOST_STREAMS];

static Stream *find_stream(const char *name, size_t size) {
    for (int i = 0; i < MOST_STREAMS; i++) {
        if (streams[i].name == NULL) {
            streams[i].name = room_for(NULL, size + 1);
            memcpy(streams[i].name, name, size);
            streams[i].name[size] = '\0';
        }
        if (strlen(streams[i].name) == size && memcmp(streams[i].name, name, size) == 0)
            return &streams[i];
    }
    return NULL;
}

static Stream *stream_at(const char *key) {
    size_t size;
    const char *name = stream_of(key, "tf/", 2, &size);
    if (name == NULL) name = stream_of(key, "tf_static/", 1, &size);
    if (name == NULL) name = stream_of(key, "@tfbus/stream/", 1, &size);
    return name ? find_stream(name, size) : NULL;
}

static int counts(Stream *stream, int64_t epoch) {
    if (stream == NULL) return 0;
    if (stream->is_known && epoch < stream->epoch) return 0;
    if (stream->is_known && epoch > stream->epoch) printf("restarted %s\n", stream->name);
    stream->is_known = 1;
    stream->epoch = epoch;
    return 1;
}

/* ------------------------------------------------------------------ A message of transforms */

static int is_usable(const Item *parent, const Item *child, const double *pose, const char **why) {
    double norm = 0.0;
    *why = "a name is no frame name";
    if (!is_frame_name(parent) || !is_frame_name(child)) return 0;
    *why = "parent and child are the same";
    if (parent->size == child->size && memcmp(parent->data, child->data, child->size) == 0)
        return 0;
    *why = "a number is not finite";
    for (int i = 0; i < 7; i++)
        if (!isfinite(pose[i])) return 0;
    *why = "the quaternion is not of length 1";
    for (int i = 3; i < 7; i++) norm += pose[i] * pose[i];
    return fabs(norm - 1.0) <= 0.01;
}

static void print_transform(const char *key, int is_static, uint32_t row, const Item *parent,
                            const Item *child, int64_t stamp_ns, const double *pose) {
    const char *why;
    if (!is_usable(parent, child, pose, &why)) {
        printf("refused transform %" PRIu32 " on %s: %s\n", row, key, why);
        return;
    }
    double norm =
        sqrt(pose[3] * pose[3] + pose[4] * pose[4] + pose[5] * pose[5] + pose[6] * pose[6]);
    printf("%.*s -> %.*s: %.9g %.9g %.9g, %.9g %.9g %.9g %.9g at %" PRId64 " (%s, %s)\n",
           (int)parent->size, (const char *)parent->data, (int)child->size,
           (const char *)child->data, pose[0], pose[1], pose[2], pose[3] / norm, pose[4] / norm,
           pose[5] / norm, pose[6] / norm, stamp_ns, is_static ? "static" : "dynamic", key);
}

static void read_doubles(const Byte *bytes, double *pose) {
    for (int i = 0; i < 7; i++) pose[i] = as_double(little_endian(bytes + 8 * i, 8));
}

/* Frames by numbers: the bytes of a pose in a form, -1 for an unknown one. */
static int size_of(Byte form) {
    static const int axis[] = {0, 2, 3, 4};
    if (form < 8) return 3 * axis[form & 3] + (form & 4 ? 6 : 0);
    return form == 8 ? 28 : form == 9 ? 56 : -1;
}

static void read_rotation(const Byte *bytes, double *quaternion) {
    uint64_t bits = little_endian(bytes, 6);
    double square = 1.0;
    for (int i = 0, at = 2; i < 4; i++) {
        if (i == (int)(bits & 3)) continue; /* the largest one */
        quaternion[i] = ((double)(bits >> at & 32767) - 16383) / (16383 * sqrt(2.0));
        square -= quaternion[i] * quaternion[i];
        at += 15;
    }
    /* Bits that are no rotation give no number, which is refused. */
    quaternion[bits & 3] = sqrt(square);
}

static void read_pose(Byte form, const Byte *bytes, const double *origin, double *pose) {
    if (form == 9) {
        read_doubles(bytes, pose);
    } else if (form == 8) {
        for (int i = 0; i < 7; i++) {
            uint32_t bits = (uint32_t)little_endian(bytes + 4 * i, 4);
            float narrow;
            memcpy(&narrow, &bits, sizeof narrow);
            pose[i] = narrow + (i < 3 ? origin[i] : 0.0);
        }
    } else {
        int width = form & 3 ? (form & 3) + 1 : 0;
        memcpy(pose, origin, 7 * sizeof *pose);
        for (int i = 0; i < 3 && width; i++) {
            uint64_t sign = (uint64_t)1 << (8 * width - 1);
            uint64_t bits = little_endian(bytes + width * i, width);
            pose[i] += (double)as_signed((bits ^ sign) - sign) * 0.0001;
        }
        if (form & 4) read_rotation(bytes + 3 * width, pose + 3);
    }
}

/* Print the transforms of a message whose frames have numbers; 0 where the whole is refused. */
static int read_numbered(Reader *reader, const char *key) {
    enum { V, EPOCH, RUNS, STAMPS, FORMS, POSES, SEQ, FIELDS };
    Field fields[FIELDS] = {{.name = "v", .kind = INTEGER, .needed = 1},
                            {.name = "epoch", .kind = INTEGER, .needed = 1},
                            {.name = "runs", .kind = ARRAY, .needed = 1},
                            {.name = "stamps", .kind = BINARY, .needed = 1, .other = INTEGER},
                            {.name = "forms", .kind = BINARY, .needed = 1},
                            {.name = "poses", .kind = BINARY, .needed = 1},
                            {.name = "seq", .kind = INTEGER}};
    if (!read_map(reader, fields, FIELDS, 2)) return 0;
    const Item *stamps = &fields[STAMPS].item, *forms = &fields[FORMS].item;
    const Item *poses = &fields[POSES].item;
    Reader runs = fields[RUNS].rest;
    uint32_t pairs = fields[RUNS].item.size / 2, rows = 0;
    if (fields[RUNS].item.size % 2) return fail(reader, "'runs' is not pairs of integers");
    for (uint32_t i = 0; i < pairs; i++) {
        Item first, count;
        next(&runs, &first); /* both were read before, so it cannot fail */
        if (first.kind != INTEGER || first.integer < 0)
            return fail(reader, "'runs' is not pairs of integers, 0 or more");
        next(&runs, &count);
        if (count.kind != INTEGER || count.integer < 0)
            return fail(reader, "'runs' is not pairs of integers, 0 or more");
        if (count.integer > MOST_ROWS - (int64_t)rows)
            return fail(reader, "it has more than %d rows", MOST_ROWS);
        rows += (uint32_t)count.integer;
    }
    int has_stamps = stamps->kind == INTEGER || stamps->size == 8 || stamps->size == 8 * rows;
    if (!has_stamps || (forms->size != 1 && forms->size != rows))
        return fail(reader, "'stamps' or 'forms' has not one for each row, or one for all");
    uint32_t at = 0;
    for (uint32_t i = 0; i < rows; i++) {
        int size = size_of(forms->data[forms->size == rows ? i : 0]);
        if (size < 0 || (uint32_t)size > poses->size - at)
            return fail(reader, "'poses' has not the bytes that 'forms' say");
        at += (uint32_t)size;
    }
    if (at != poses->size) return fail(reader, "bytes follow the poses");
    Stream *stream = stream_at(key);
    if (!counts(stream, fields[EPOCH].item.integer)) return 1;
    const Numbers *numbers = &stream->numbers;
    int is_described = numbers->epoch == fields[EPOCH].item.integer;
    runs = fields[RUNS].rest;
    for (uint32_t pair = 0, row = 0, from = 0; pair < pairs; pair++) {
        Item first, count;
        next(&runs, &first), next(&runs, &count);
        for (int64_t i = 0; i < count.integer; i++, row++) {
            uint64_t number = (uint64_t)first.integer + (uint64_t)i;
            Byte form = forms->data[forms->size == rows ? row : 0];
            const Numbered *found =
                is_described && number <= INT64_MAX ? find_number(numbers, (int64_t)number) : NULL;
            int is_given = is_described && numbers->next_number > 0 &&
                           number < (uint64_t)numbers->next_number;
            if (found) {
                double pose[7];
                int64_t stamp_ns = stamps->integer;
                if (stamps->kind == BINARY)
                    stamp_ns = as_signed(
                        little_endian(stamps->data + (stamps->size == 8 * rows ? 8 * row : 0), 8));
                read_pose(form, poses->data + from, found->origin, pose);
                print_transform(key, 0, row, &found->parent, &found->child, stamp_ns, pose);
            } else if (!is_given) {
                /* A larger program holds the message, and queries the description. */
                printf("no name yet for number %" PRIu64 " on %s\n", number, key);
            }
            from += (uint32_t)size_of(form);
        }
    }
    return 1;
}

/* Print the transforms of a message, where its epoch counts; 0 where the whole is refused. */
static int read_transforms(Reader *reader, const char *key, int is_static) {
    enum { V, EPOCH, FRAMES, EDGES, STAMPS, POSES, SEQ, FIELDS };
    Field fields[FIELDS] = {{.name = "v", .kind = INTEGER, .needed = 1},
                            {.name = "epoch", .kind = INTEGER, .needed = 1},
                            {.name = "frames", .kind = ARRAY, .needed = 1},
                            {.name = "edges", .kind = BINARY, .needed = 1},
                            {.name = "stamps", .kind = BINARY, .needed = 1},
                            {.name = "poses", .kind = BINARY, .needed = 1},
                            {.name = "seq", .kind = INTEGER}};
    Reader whole = *reader;
    if (!read_map(reader, fields, 1, 2)) return 0;
    if (fields[V].item.integer == 2 && is_static)
        return fail(reader, "its frames have numbers, and static transforms have names");
    *reader = whole;
    if (fields[V].item.integer == 2) return read_numbered(reader, key);
    if (!read_map(reader, fields, FIELDS, 2)) return 0;
    uint32_t rows = fields[STAMPS].item.size / 8, count = fields[FRAMES].item.size;
    if (fields[STAMPS].item.size % 8 || fields[EDGES].item.size % 8 || fields[POSES].item.size % 56)
        return fail(reader, "a column is not a whole number of rows");
    if (fields[EDGES].item.size / 8 != rows || fields[POSES].item.size / 56 != rows)
        return fail(reader, "the columns differ in their number of rows");
    const Byte *edges = fields[EDGES].item.data;
    for (uint32_t i = 0; i < 2 * rows; i++)
        if (little_endian(edges + 4 * i, 4) >= count)
            return fail(reader, "an index in 'edges' is not one of 'frames'");
    Item *frames = room_for(NULL, count * sizeof *frames);
    int good = 1;
    for (uint32_t i = 0; i < count && good; i++) {
        next(&fields[FRAMES].rest, &frames[i]); /* was read before, so it cannot fail */
        if (frames[i].kind != TEXT) good = fail(reader, "'frames' is not an array of texts");
    }
    if (good && counts(stream_at(key), fields[EPOCH].item.integer)) {
        for (uint32_t i = 0; i < rows; i++) {
            const Item *parent = &frames[little_endian(edges + 8 * i, 4)];
            const Item *child = &frames[little_endian(edges + 8 * i + 4, 4)];
            double pose[7];
            read_doubles(fields[POSES].item.data + 56 * i, pose);
            print_transform(key, is_static, i, parent, child,
                            as_signed(little_endian(fields[STAMPS].item.data + 8 * i, 8)), pose);
        }
    }
    free(frames);
    return good;
}

/* Read the rows of numbers of a description, whose names are in `numbers->description`. */
static int read_numbers(Reader *rest, Reader *reader, uint32_t count, const Item *origins,
                        Numbers *numbers) {
    if (origins->size != 56 * (uint64_t)count)
        return fail(reader, "'origins' has not a pose for each of 'numbered'");
    numbers->rows = room_for(NULL, count * sizeof *numbers->rows);
    for (uint32_t i = 0; i < count; i++) {
        Item row, number;
        Numbered *found = &numbers->rows[i];
        next(rest, &row); /* was read before, so it cannot fail */
        if (row.kind != ARRAY || row.size != 3 || !next(rest, &number) ||
            !next(rest, &found->parent) || !next(rest, &found->child) || number.kind != INTEGER ||
            found->parent.kind != TEXT || found->child.kind != TEXT)
            return fail(reader, "'numbered' is not an array of [integer, text, text]");
        found->number = number.integer;
        read_doubles(origins->data + 56 * i, found->origin);
    }
    numbers->count = count;
    qsort(numbers->rows, count, sizeof *numbers->rows, by_number);
    return 1;
}

/* Print the description of a stream (Streams and nodes); 0 where it is refused. */
static int read_description(Reader *reader, const char *key) {
    enum { V, NODE, EPOCH, FRAMES, HOST, PID, SESSION, PRIORITY, SPLIT, HISTORY, STARTED, POSES,
           NUMBERED, ORIGINS, NEXT_NUMBER, FIELDS };
    Field fields[FIELDS] = {
        {.name = "v", .kind = INTEGER, .needed = 1},
        {.name = "node", .kind = TEXT, .needed = 1},
        {.name = "epoch", .kind = INTEGER, .needed = 1},
        {.name = "frames", .kind = ARRAY, .needed = 1},
        {.name = "host", .kind = TEXT},
        {.name = "pid", .kind = INTEGER},
        {.name = "session", .kind = TEXT},
        {.name = "priority", .kind = INTEGER},
        {.name = "split", .kind = BOOLEAN},
        {.name = "history_s", .kind = FLOAT},
        {.name = "started_ns", .kind = INTEGER},
        {.name = "poses", .kind = TEXT},
        {.name = "numbered", .kind = ARRAY},
        {.name = "origins", .kind = BINARY},
        {.name = "next_number", .kind = INTEGER}};
    const Byte *payload = reader->at, *end = reader->end;
    if (!read_map(reader, fields, FIELDS, 1)) return 0;
    Reader *rest = &fields[FRAMES].rest;
    uint32_t count = fields[FRAMES].item.size, frames = 0;
    for (uint32_t i = 0; i < count; i++) {
        Item edge, parent, child, is_static;
        next(rest, &edge);
        if (edge.kind != ARRAY || edge.size != 3)
            return fail(reader, "'frames' is not an array of [text, text, boolean]");
        if (!next(rest, &parent) || !next(rest, &child) || !next(rest, &is_static) ||
            parent.kind != TEXT || child.kind != TEXT ||
            (is_static.kind != BOOLEAN && !stands_for(&is_static, BOOLEAN)))
            return fail(reader, "'frames' is not an array of [text, text, boolean]");
        frames += is_frame_name(&parent) && is_frame_name(&child); /* others are left out */
    }
    const Item *node = &fields[NODE].item, *host = &fields[HOST].item;
    if (!is_name(node) || !is_name(host) || !is_name(&fields[SESSION].item) ||
        !is_name(&fields[POSES].item))
        return fail(reader, "the name of its node, host, session or poses cannot be printed");
    /* The names of numbers are needed later: keep a copy, and read them there. */
    Numbers numbers = {.epoch = fields[EPOCH].item.integer,
                       .next_number = fields[NEXT_NUMBER].item.integer};
    Reader numbered = fields[NUMBERED].rest;
    size_t size = (size_t)(end - payload);
    numbers.description = room_for(NULL, size);
    memcpy(numbers.description, payload, size);
    if (numbered.at) {
        numbered.at = numbers.description + (numbered.at - payload);
        numbered.end = numbers.description + size;
    }
    Stream *stream = stream_at(key);
    if (!read_numbers(&numbered, reader, fields[NUMBERED].item.size, &fields[ORIGINS].item,
                      &numbers)) {
        forget_numbers(&numbers);
        return 0;
    }
    forget_numbers(stream ? &stream->numbers : &numbers);
    if (stream) stream->numbers = numbers;
    printf("description on %s: node %.*s, host %.*s, pid %" PRId64 ", epoch %" PRId64
           ", %" PRIu32 " frames\n",
           key, (int)node->size, (const char *)node->data, (int)host->size,
           host->size ? (const char *)host->data : "", fields[PID].item.integer,
           fields[EPOCH].item.integer, frames);
    return 1;
}

/* --------------------------------------------------------------------- Writing MessagePack */

typedef struct {
    Byte *data;
    size_t size, room;
} Writer;

static void put(Writer *writer, const void *bytes, size_t size) {
    if (writer->size + size > writer->room) {
        writer->room = 2 * (writer->size + size);
        writer->data = room_for(writer->data, writer->room);
    }
    memcpy(writer->data + writer->size, bytes, size);
    writer->size += size;
}

/* A tag and its number in that many bytes, big-endian. */
static void put_tag(Writer *writer, Byte tag, uint64_t number, int width) {
    Byte bytes[9] = {tag};
    for (int i = width; i > 0; i--, number >>= 8) bytes[i] = (Byte)number;
    put(writer, bytes, (size_t)width + 1);
}

/* MessagePack lets any number stand in its longest form. */
static void put_integer(Writer *writer, int64_t number) {
    put_tag(writer, 0xD3, (uint64_t)number, 8);
}

static void put_float(Writer *writer, double number) {
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    put_tag(writer, 0xCB, bits, 8);
}

static void put_text(Writer *writer, const char *text) {
    put_tag(writer, 0xDB, strlen(text), 4);
    put(writer, text, strlen(text));
}

static void put_boolean(Writer *writer, int is_true) {
    put_tag(writer, is_true ? 0xC3 : 0xC2, 0, 0);
}

static void put_array(Writer *writer, uint32_t size) { put_tag(writer, 0xDD, size, 4); }

static void put_map(Writer *writer, uint32_t size) { put_tag(writer, 0xDF, size, 4); }

static void put_little_endian(Writer *writer, uint64_t number, int width) {
    Byte bytes[8];
    for (int i = 0; i < width; i++, number >>= 8) bytes[i] = (Byte)number;
    put(writer, bytes, (size_t)width);
}

/* A message of one transform (A message of transforms). */
static void write_transform(Writer *writer, int64_t epoch, int64_t seq, const char *parent,
                            const char *child, int64_t stamp_ns, const double *pose) {
    put_map(writer, 7);
    put_text(writer, "v"), put_integer(writer, 1);
    put_text(writer, "epoch"), put_integer(writer, epoch);
    put_text(writer, "seq"), put_integer(writer, seq);
    put_text(writer, "frames"), put_array(writer, 2);
    put_text(writer, parent), put_text(writer, child);
    put_text(writer, "edges"), put_tag(writer, 0xC6, 8, 4);
    put_little_endian(writer, 0, 4), put_little_endian(writer, 1, 4);
    put_text(writer, "stamps"), put_tag(writer, 0xC6, 8, 4);
    put_little_endian(writer, (uint64_t)stamp_ns, 8);
    put_text(writer, "poses"), put_tag(writer, 0xC6, 56, 4);
    for (int i = 0; i < 7; i++) {
        uint64_t bits;
        memcpy(&bits, &pose[i], sizeof bits);
        put_little_endian(writer, bits, 8);
    }
}

static void send(const char *verb, Writer *writer, const char *root, const char *name) {
    printf("%s ", verb);
    for (size_t i = 0; i < writer->size; i++) printf("%02x", writer->data[i]);
    printf(" %s%s\n", root, name);
    writer->size = 0;
}

/* -------------------------------------------------------------------------------- The programs */

static void listen(const char *key, const Byte *payload, size_t size) {
    size_t name_size;
    Reader reader = {.at = payload, .end = payload + size};
    int good = 1;
    /* Beside ROS 2: CDR begins so. */
    int is_cdr = size >= 4 && payload[0] == 0 && payload[1] <= 11;
    if (stream_of(key, "@tfbus/stream/", 1, &name_size))
        good = read_description(&reader, key);
    else if (stream_of(key, "tf/", 2, &name_size) && !is_cdr)
        good = read_transforms(&reader, key, 0);
    else if (stream_of(key, "tf_static/", 1, &name_size) && !is_cdr)
        good = read_transforms(&reader, key, 1);
    if (!good) printf("refused %s: %s\n", key, reader.error);
}

static void lose(const char *key) {
    Stream *stream = stream_at(key);
    if (stream) {
        stream->is_known = 0;
        forget_numbers(&stream->numbers);
    }
    printf("gone %s\n", key);
}

/* Publish NAME, which moves up and down, and the static NAME_camera. */
static void talk(const char *name, const char *session, const char *host, int64_t pid,
                 int64_t now_ns) {
    static int64_t started_ns = 0, seq = 0;
    static Writer writer;
    char node[80], camera[80];
    snprintf(node, sizeof node, "/%s", name);
    snprintf(camera, sizeof camera, "%s_camera", name);
    if (started_ns == 0) {
        const double mount[] = {0.1, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0};
        started_ns = now_ns;
        /* Streams and nodes */
        put_map(&writer, 14);
        put_text(&writer, "name"), put_text(&writer, node);
        put_text(&writer, "host"), put_text(&writer, host);
        put_text(&writer, "pid"), put_integer(&writer, pid);
        put_text(&writer, "version"), put_text(&writer, "tfbus_wire.c");
        put_text(&writer, "session"), put_text(&writer, session);
        put_text(&writer, "started_ns"), put_integer(&writer, started_ns);
        put_text(&writer, "streams"), put_array(&writer, 1), put_text(&writer, name);
        put_text(&writer, "unread"), put_array(&writer, 0);
        put_text(&writer, "buffers"), put_array(&writer, 0);
        put_text(&writer, "publishes"), put_map(&writer, 0);
        put_text(&writer, "subscribes"), put_map(&writer, 0);
        put_text(&writer, "serves"), put_map(&writer, 0);
        put_text(&writer, "calls"), put_map(&writer, 0);
        put_text(&writer, "parameters"), put_array(&writer, 0);
        send("answer", &writer, "@tfbus/node/", name);
        printf("token @tfbus/node/%s\n", name);
        put_map(&writer, 9);
        put_text(&writer, "v"), put_integer(&writer, 1);
        put_text(&writer, "node"), put_text(&writer, node);
        put_text(&writer, "epoch"), put_integer(&writer, started_ns);
        put_text(&writer, "frames"), put_array(&writer, 2);
        put_array(&writer, 3), put_text(&writer, "world"), put_text(&writer, name);
        put_boolean(&writer, 0);
        put_array(&writer, 3), put_text(&writer, name), put_text(&writer, camera);
        put_boolean(&writer, 1);
        put_text(&writer, "host"), put_text(&writer, host);
        put_text(&writer, "pid"), put_integer(&writer, pid);
        put_text(&writer, "session"), put_text(&writer, session);
        put_text(&writer, "started_ns"), put_integer(&writer, started_ns);
        put_text(&writer, "history_s"), put_float(&writer, 0.0);
        send("retain", &writer, "@tfbus/stream/", name);
        write_transform(&writer, started_ns, 0, name, camera, started_ns, mount);
        send("retain", &writer, "tf_static/", name);
        printf("token @tfbus/stream/%s\n", name);
    }
    double height = sin((double)(now_ns - started_ns) / 1e9);
    const double pose[] = {1.0, 2.0, height, 0.0, 0.0, 0.6, 0.8};
    write_transform(&writer, started_ns, seq++, "world", name, now_ns, pose);
    send("put", &writer, "tf/", name);
}

static int from_hex(int digit) {
    return digit >= '0' && digit <= '9'   ? digit - '0'
           : digit >= 'a' && digit <= 'f' ? digit - 'a' + 10
                                          : -1;
}

/* Decode the digits where they are: the number of bytes, or -1. */
static long decode_hex(char *text, size_t size) {
    if (size % 2) return -1;
    for (size_t i = 0; i < size / 2; i++) {
        int high = from_hex(text[2 * i]), low = from_hex(text[2 * i + 1]);
        if (high < 0 || low < 0) return -1;
        ((Byte *)text)[i] = (Byte)(high << 4 | low);
    }
    return (long)(size / 2);
}

/* Read a line, however long; what is beyond the largest message is left out. 0 at the end. */
static int read_line(Writer *line) {
    const size_t most = 2 * (size_t)MOST_BYTES + 65536;
    char part[65536];
    line->size = 0;
    while (fgets(part, sizeof part, stdin)) {
        size_t size = strcspn(part, "\n");
        if (line->size < most) put(line, part, size);
        if (part[size] == '\n') {
            put(line, "", 1);
            return 1;
        }
    }
    return 0;
}

/* Names in keys: such a name needs no escape in a key. */
static int is_node_name(const char *name) {
    size_t size = strlen(name);
    return size > 0 && size <= 64 && *name != '-' && *name != '.' &&
           strspn(name, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-.") == size;
}

int main(int count, char **arguments) {
    const char *name = NULL;
    if (count == 3 && strcmp(arguments[1], "talk") == 0 && is_node_name(arguments[2]))
        name = arguments[2];
    else if (count != 2 || strcmp(arguments[1], "listen") != 0) {
        fprintf(stderr, "usage: tfbus_wire listen | talk NAME\n"
                        "NAME has at most 64 of a-z A-Z 0-9 _ - . and does not begin with - or .\n");
        return 2;
    }
    Writer line = {0};
    char session[80] = "", host[256] = "";
    int64_t pid = 0, now_ns;
    while (read_line(&line)) {
        char *text = (char *)line.data;
        if (name) {
            sscanf(text, "session %79s %255s %" SCNd64, session, host, &pid);
            if (sscanf(text, "now %" SCNd64, &now_ns) == 1)
                talk(name, session, host, pid, now_ns);
        } else if (strncmp(text, "message ", 8) == 0) {
            char *hex = text + 8, *key = strchr(hex, ' ');
            long size = key ? decode_hex(hex, (size_t)(key - hex)) : -1;
            if (size < 0) printf("not a message: %.60s\n", text);
            /* A copy of its own size lets a sanitizer see what is read beyond it. */
            Byte *payload = room_for(NULL, size > 0 ? (size_t)size : 0);
            if (size > 0) memcpy(payload, hex, (size_t)size);
            if (size >= 0) listen(key + 1, payload, (size_t)size);
            free(payload);
        } else if (strncmp(text, "alive ", 6) == 0) {
            printf("there %s\n", text + 6);
        } else if (strncmp(text, "lost ", 5) == 0) {
            lose(text + 5);
        }
        fflush(stdout);
    }
    free(line.data);
    return 0;
}
