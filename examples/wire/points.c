/* Reads the points of a cloud where they lie in a message, in C99 alone.
 *
 *     cc -std=c99 -O2 -o points examples/wire/points.c
 *     ./points < message        # the bytes of a sensor_msgs/msg/PointCloud2 on the bus
 *
 * It prints how many points there are, and the mean of x, y and z. docs/reference/messages.md says
 * how an array stands in a message; little-endian machines read its numbers as they are.
 */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef unsigned char Byte;
typedef struct { const Byte *at, *end; } Cursor;
/* A value: 'n'umber, 't'ext or 'b'inary with its bytes, 'm'ap or 'a'rray with its size, or '0'. */
typedef struct { char kind; int64_t number; const Byte *bytes; uint32_t size; } Item;

static uint64_t big_endian(Cursor *cursor, int width) {
    uint64_t number = 0;
    if (cursor->end - cursor->at < width) { cursor->at = cursor->end; return 0; }
    while (width--) number = number << 8 | *cursor->at++;
    return number;
}

static Item sized(Cursor *cursor, char kind, uint64_t size) {
    Item item = {kind, 0, cursor->at, (uint32_t)size};
    if (kind == 't' || kind == 'b') {
        if ((uint64_t)(cursor->end - cursor->at) < size) size = item.size = 0, item.kind = '0';
        cursor->at += size;
    }
    return item;
}

static Item next(Cursor *cursor) {
    Item none = {'0', 0, NULL, 0};
    Byte head = (Byte)big_endian(cursor, 1);
    if (head < 0x80) { none.kind = 'n'; none.number = head; return none; }
    if (head < 0x90) return sized(cursor, 'm', head & 15);
    if (head < 0xA0) return sized(cursor, 'a', head & 15);
    if (head < 0xC0) return sized(cursor, 't', head & 31);
    if (head >= 0xC4 && head <= 0xC6) return sized(cursor, 'b', big_endian(cursor, 1 << (head - 0xC4)));
    if (head >= 0xD9 && head <= 0xDB) return sized(cursor, 't', big_endian(cursor, 1 << (head - 0xD9)));
    if (head == 0xDC || head == 0xDD) return sized(cursor, 'a', big_endian(cursor, 2 << (head - 0xDC)));
    if (head == 0xDE || head == 0xDF) return sized(cursor, 'm', big_endian(cursor, 2 << (head - 0xDE)));
    if (head >= 0xCC && head <= 0xD3) {
        none.kind = 'n';
        none.number = (int64_t)big_endian(cursor, 1 << ((head - 0xCC) & 3));
    } else if (head == 0xCA || head == 0xCB) {
        big_endian(cursor, head == 0xCA ? 4 : 8);
    }
    return none;
}

static void skip(Cursor *cursor, Item item, int depth) {
    uint64_t left = item.kind == 'm' ? 2 * (uint64_t)item.size : item.kind == 'a' ? item.size : 0;
    if (depth < 32)
        while (left-- && cursor->at < cursor->end) skip(cursor, next(cursor), depth + 1);
}

static int is(Item item, const char *text) {
    return item.kind == 't' && item.size == strlen(text) && !memcmp(item.bytes, text, item.size);
}

int main(void) {
    size_t size = 0, room = 1 << 20;
    Byte *message = malloc(room);
    for (size_t got; message && (got = fread(message + size, 1, room - size, stdin));) {
        size += got;
        if (size == room) message = realloc(message, room *= 2);
    }
    if (!message) return 1;

    Cursor cursor = {message, message + size};
    Item data = {'0', 0, NULL, 0};
    int64_t width = 0, height = 0, step = 0, row_step = 0, offsets[3] = {-1, -1, -1};
    for (uint32_t fields = next(&cursor).size; fields-- && cursor.at < cursor.end;) {
        Item name = next(&cursor), value = next(&cursor);
        if (is(name, "data")) data = value;
        else if (is(name, "width")) width = value.number;
        else if (is(name, "height")) height = value.number;
        else if (is(name, "point_step")) step = value.number;
        else if (is(name, "row_step")) row_step = value.number;
        else if (is(name, "fields") && value.kind == 'a') {
            for (uint32_t columns = value.size; columns-- && cursor.at < cursor.end;) {
                Item column = {'0', 0, NULL, 0};
                int64_t offset = 0, datatype = 0;
                for (uint32_t parts = next(&cursor).size; parts-- && cursor.at < cursor.end;) {
                    Item key = next(&cursor), part = next(&cursor);
                    if (is(key, "name")) column = part;
                    else if (is(key, "offset")) offset = part.number;
                    else if (is(key, "datatype")) datatype = part.number;
                }
                for (int axis = 0; axis < 3; axis++) {
                    char text[2] = {"xyz"[axis], 0};
                    if (is(column, text) && datatype == 7) offsets[axis] = offset; /* float32 */
                }
            }
        } else skip(&cursor, value, 0);
    }
    if (data.kind != 'b' || width < 0 || height < 0 || step < 1 || row_step < width * step ||
        (height && data.size / height < row_step)) {
        fprintf(stderr, "no cloud, or a part of one\n");
        return 1;
    }
    double sums[3] = {0, 0, 0};
    for (int axis = 0; axis < 3; axis++) {
        if (offsets[axis] < 0 || offsets[axis] + 4 > step) return 1;
        for (int64_t row = 0; row < height; row++)
            for (int64_t column = 0; column < width; column++) {
                float number; /* as it lies there; it may not be aligned */
                memcpy(&number, data.bytes + row * row_step + column * step + offsets[axis], 4);
                sums[axis] += number;
            }
    }
    double count = (double)(width * height);
    printf("%.0f %.6g %.6g %.6g\n", count, sums[0] / count, sums[1] / count, sums[2] / count);
    free(message);
    return 0;
}
